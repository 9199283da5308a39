/* zeromq TRIPS REQUEST_BYTES REPLY_BYTES: a request and its reply over ZeroMQ's PAIR sockets on ipc, between two processes. */
#include "trips.h"
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>
#include <zmq.h>

static void *end;
static char request[1 << 16], reply[1 << 16], name[64];
static size_t request_bytes, reply_bytes;

static void open_end(int (*attach)(void *, const char *))
{
    end = zmq_socket(zmq_ctx_new(), ZMQ_PAIR);
    require(end != NULL && attach(end, name) == 0, "zmq_socket");
}

static void trip(void)
{
    require(zmq_send(end, request, request_bytes, 0) == (int)request_bytes, "zmq_send");
    require(zmq_recv(end, reply, sizeof reply, 0) == (int)reply_bytes, "zmq_recv");
}

int main(int count, char **arguments)
{
    require(count == 4, "usage: zeromq TRIPS REQUEST_BYTES REPLY_BYTES");
    request_bytes = strtoul(arguments[2], NULL, 10);
    reply_bytes = strtoul(arguments[3], NULL, 10);
    snprintf(name, sizeof name, "ipc://@motord-compare-%d", (int)getpid());
    pid_t echo = fork();
    require(echo >= 0, "fork");
    if (echo == 0) {
        open_end(zmq_bind);
        while (zmq_recv(end, request, sizeof request, 0) > 0)
            require(zmq_send(end, reply, reply_bytes, 0) > 0, "zmq_send");
    }
    open_end(zmq_connect);
    time_trips("zeromq", strtoul(arguments[1], NULL, 10), trip);
    kill(echo, SIGKILL);
    waitpid(echo, NULL, 0);
}
