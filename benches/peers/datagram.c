/* datagram TRIPS REQUEST_BYTES REPLY_BYTES: a request and its reply over Unix datagram sockets, between two processes. */
#include "trips.h"
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

static int ends[2];
static char request[1 << 16], reply[1 << 16];
static size_t request_bytes, reply_bytes;

static void trip(void)
{
    require(send(ends[0], request, request_bytes, 0) == (ssize_t)request_bytes, "send");
    require(recv(ends[0], reply, sizeof reply, 0) == (ssize_t)reply_bytes, "recv");
}

int main(int count, char **arguments)
{
    require(count == 4, "usage: datagram TRIPS REQUEST_BYTES REPLY_BYTES");
    request_bytes = strtoul(arguments[2], NULL, 10);
    reply_bytes = strtoul(arguments[3], NULL, 10);
    require(socketpair(AF_UNIX, SOCK_DGRAM, 0, ends) == 0, "socketpair");
    pid_t echo = fork();
    require(echo >= 0, "fork");
    if (echo == 0)
        while (recv(ends[1], request, sizeof request, 0) > 0)
            require(send(ends[1], reply, reply_bytes, 0) > 0, "send");
    time_trips("datagram", strtoul(arguments[1], NULL, 10), trip);
    kill(echo, SIGKILL);
    waitpid(echo, NULL, 0);
}
