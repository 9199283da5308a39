/* lcm TRIPS REQUEST_BYTES REPLY_BYTES: a request and its reply over LCM's multicast on loopback, between two processes. A message
 * that the kernel loses is asked for again after 100 ms. */
#include "trips.h"
#include <lcm/lcm.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

static const char *const group = "udpm://239.255.76.67:7667?ttl=0";
static lcm_t *end;
static char request[1 << 16], reply[1 << 16];
static unsigned request_bytes, reply_bytes;

static void ignore(const lcm_recv_buf_t *message, const char *channel, void *user)
{
    (void)message, (void)channel, (void)user;
}

static void answer(const lcm_recv_buf_t *message, const char *channel, void *user)
{
    (void)message, (void)channel, (void)user;
    require(lcm_publish(end, "STATE", reply, reply_bytes) == 0, "lcm_publish");
}

static void open_end(const char *channel, lcm_msg_handler_t handler)
{
    end = lcm_create(group);
    require(end != NULL && lcm_subscribe(end, channel, handler, NULL) != NULL, "lcm_create");
}

static void trip(void)
{
    do
        require(lcm_publish(end, "SETPOINT", request, request_bytes) == 0, "lcm_publish");
    while (lcm_handle_timeout(end, 100) == 0);
}

int main(int count, char **arguments)
{
    require(count == 4, "usage: lcm TRIPS REQUEST_BYTES REPLY_BYTES");
    request_bytes = (unsigned)strtoul(arguments[2], NULL, 10);
    reply_bytes = (unsigned)strtoul(arguments[3], NULL, 10);
    pid_t echo = fork();
    require(echo >= 0, "fork");
    if (echo == 0) {
        open_end("SETPOINT", answer);
        while (lcm_handle(end) == 0)
            ;
    }
    open_end("STATE", ignore);
    time_trips("lcm", strtoul(arguments[1], NULL, 10), trip);
    kill(echo, SIGKILL);
    waitpid(echo, NULL, 0);
}
