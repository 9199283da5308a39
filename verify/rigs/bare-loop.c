/* bare-loop SECONDS RATE_HZ INTERFACE...: the least that a control loop over SocketCAN can do, as a yardstick.
 *
 * In every cycle: sleep until the next tick, one sendmmsg of three dynamic-control frames on every interface,
 * one sleep while the motors answer, one recvmmsg on every interface. Sockets receive what motord's do: exact filters,
 * error reports, receive stamps, drop counter. Nothing is decoded, decided, checked or told.
 *
 * It stays as it is, so that the ratios of all versions of motord have one measure. motord has become cheaper in two
 * ways: it asks for as many frames as replies are awaited, and for its stamps by SO_TIMESTAMPNS.
 *
 * Prints: cycles run, replies received, processor time of the thread in ns.
 */
#define _GNU_SOURCE
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/net_tstamp.h>
#include <net/if.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>

enum { MOTORS = 3, ROOM = 64, CONTROL = 88, BUSES = 8, HOST_ID = 0x100, REPLIES_AFTER_NS = 420000 };

struct bus {
    int socket;
    struct can_frame out[MOTORS];
    struct canfd_frame in[ROOM];
    char control[ROOM][CONTROL];
    struct iovec out_vector[MOTORS], in_vector[ROOM];
    struct mmsghdr out_header[MOTORS], in_header[ROOM];
};

static struct bus buses[BUSES];

static void check(int ok, const char *what)
{
    if (!ok) {
        perror(what);
        exit(1);
    }
}

static void set(int socket, int level, int option, const void *value, socklen_t length)
{
    check(setsockopt(socket, level, option, value, length) == 0, "setsockopt");
}

static void open_bus(struct bus *bus, const char *interface)
{
    struct sockaddr_can address = { .can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(interface) };
    struct can_filter filters[MOTORS];
    can_err_mask_t errors = CAN_ERR_TX_TIMEOUT | CAN_ERR_LOSTARB | CAN_ERR_CRTL | CAN_ERR_ACK | CAN_ERR_BUSOFF | CAN_ERR_RESTARTED;
    int stamps = SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE, one = 1, zero = 0, send_buffer = 8 * 768 / 2;

    bus->socket = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    check(bus->socket >= 0, interface);
    for (int motor = 0; motor < MOTORS; motor++) {
        /* Neutral: position, velocity and torque zero, no stiffness, no damping (MIT document, control command). */
        static const __u8 neutral[8] = { 0x80, 0, 0x80, 0, 0, 0, 0x08, 0 };
        filters[motor] = (struct can_filter){ HOST_ID + motor + 1, CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_SFF_MASK };
        bus->out[motor].can_id = (canid_t)motor + 1;
        bus->out[motor].can_dlc = 8;
        memcpy(bus->out[motor].data, neutral, sizeof neutral);
        bus->out_vector[motor] = (struct iovec){ &bus->out[motor], sizeof bus->out[motor] };
        bus->out_header[motor].msg_hdr = (struct msghdr){ .msg_iov = &bus->out_vector[motor], .msg_iovlen = 1 };
    }
    for (int place = 0; place < ROOM; place++) {
        bus->in_vector[place] = (struct iovec){ &bus->in[place], sizeof bus->in[place] };
        bus->in_header[place].msg_hdr = (struct msghdr){ .msg_iov = &bus->in_vector[place], .msg_iovlen = 1 };
    }
    set(bus->socket, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof filters);
    set(bus->socket, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors);
    set(bus->socket, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &zero, sizeof zero);
    set(bus->socket, SOL_SOCKET, SO_TIMESTAMPING, &stamps, sizeof stamps);
    set(bus->socket, SOL_SOCKET, SO_RXQ_OVFL, &one, sizeof one);
    set(bus->socket, SOL_SOCKET, SO_SNDBUF, &send_buffer, sizeof send_buffer);
    check(bind(bus->socket, (struct sockaddr *)&address, sizeof address) == 0, "bind");
}

static int receive(struct bus *bus)
{
    for (int place = 0; place < ROOM; place++) {
        bus->in_header[place].msg_hdr.msg_control = bus->control[place];
        bus->in_header[place].msg_hdr.msg_controllen = CONTROL;
    }
    int received = recvmmsg(bus->socket, bus->in_header, ROOM, MSG_DONTWAIT, NULL);
    return received > 0 ? received : 0;
}

static long long nanoseconds(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static void sleep_until(long long instant)
{
    struct timespec until = { instant / 1000000000, instant % 1000000000 };
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

int main(int count, char **arguments)
{
    struct sched_param priority = { .sched_priority = 80 };
    int used = count - 3;
    if (used < 1 || used > BUSES) {
        fprintf(stderr, "usage: bare-loop SECONDS RATE_HZ INTERFACE...\n");
        return 64;
    }
    long long period = 1000000000LL / atoi(arguments[2]), cycles = atoi(arguments[1]) * (1000000000LL / period), ran = 0, replies = 0;
    for (int bus = 0; bus < used; bus++)
        open_bus(&buses[bus], arguments[bus + 3]);
    check(mlockall(MCL_CURRENT | MCL_FUTURE) == 0, "mlockall");
    check(sched_setscheduler(0, SCHED_FIFO, &priority) == 0, "sched_setscheduler");

    long long place = nanoseconds(CLOCK_MONOTONIC) + period, last = place + cycles * period, before = nanoseconds(CLOCK_THREAD_CPUTIME_ID);
    while (place < last) {
        sleep_until(place);
        for (int bus = 0; bus < used; bus++)
            sendmmsg(buses[bus].socket, buses[bus].out_header, MOTORS, MSG_DONTWAIT);
        sleep_until(nanoseconds(CLOCK_MONOTONIC) + REPLIES_AFTER_NS);
        for (int bus = 0; bus < used; bus++)
            replies += receive(&buses[bus]);
        ran++;
        long long now = nanoseconds(CLOCK_MONOTONIC);
        do
            place += period;
        while (place < now);
    }
    printf("%lld %lld %lld\n", ran, replies, nanoseconds(CLOCK_THREAD_CPUTIME_ID) - before);
}
