/* Stops the robot from handlers of SIGALRM and SIGSEGV, while the program waits for states, sends setpoints, and allocates.
 *
 *   signals [INSTANCE [GROUP [STOPS]]]
 *
 * Each stop must be confirmed, must be latched in the states afterwards, and must allocate nothing. Every tenth signal is a SIGSEGV.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <motord.h>
#include <setjmp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <unistd.h>

extern void *__libc_malloc(size_t size);
extern void __libc_free(void *memory);

static motord_client *client;
static volatile sig_atomic_t stops, unconfirmed, allocations, changed_errno, in_handler;
static volatile motord_status last = MOTORD_STATUS_OK;
static sigjmp_buf after_fault;

/* The program's malloc and free: the library uses them too. */
void *malloc(size_t size) {
    if (in_handler) ++allocations;
    return __libc_malloc(size);
}

void free(void *memory) {
    if (in_handler && memory) ++allocations;
    __libc_free(memory);
}

static void handle(int signal) {
    in_handler = 1;
    errno = 1234;
    motord_status status = motord_emergency_stop_signal_safe(client);
    if (errno != 1234) ++changed_errno;
    if (status != MOTORD_STATUS_OK) {
        ++unconfirmed;
        last = status;
    }
    in_handler = 0;
    ++stops;
    if (signal == SIGSEGV) siglongjmp(after_fault, 1);
}

static int failed(const char *what) {
    fprintf(stderr, "signals: %s: %s\n", what, motord_error_message());
    return EXIT_FAILURE;
}

/* Waits, sends, and allocates until the next signal. */
static int work(motord_claim *claim, motord_state *state, int until) {
    while (stops < until) {
        double values[64];
        const double limp[64] = {0};
        motord_status status = motord_wait(client, 1000000000, state);
        if (status != MOTORD_STATUS_OK && status != MOTORD_STATUS_TIMEOUT) return failed("wait");
        size_t count = motord_claim_count(claim);
        if (motord_read(state, claim, MOTORD_QUANTITY_POSITION, count, values) != MOTORD_STATUS_OK) return failed("read");
        for (int turn = 0; turn < 50 && stops < until; ++turn) {
            if (motord_send(claim, count, values, NULL, limp, NULL, NULL) != MOTORD_STATUS_OK) return failed("send");
            void *memory = malloc(16u << turn % 10);
            memset(memory, turn, 16);
            free(memory);
        }
    }
    return EXIT_SUCCESS;
}

/* The states show the stop; then it is reset. */
static int check(motord_claim *claim, motord_state *state) {
    motord_cycle cycle = {0};
    for (int turn = 0; turn < 1000 && !cycle.emergency_stop; ++turn) {
        if (motord_wait(client, 1000000000, state) != MOTORD_STATUS_OK) return failed("wait");
        motord_state_cycle(state, &cycle);
    }
    if (!cycle.emergency_stop) return failed("the stop is not latched");
    for (int turn = 0; turn < 1000; ++turn) {
        if (motord_reset(claim) == MOTORD_STATUS_OK) return EXIT_SUCCESS;
        usleep(1000);
    }
    return failed("reset");
}

/* A signal after 0.1 to 3 ms. */
static void alarm_soon(int stop) {
    struct itimerval timer = {{0, 0}, {0, 100 + stop * 37 % 2900}};
    setitimer(ITIMER_REAL, &timer, NULL);
}

int main(int argc, char **argv) {
    const char *group = argc > 2 ? argv[2] : "legs";
    int wanted = argc > 3 ? atoi(argv[3]) : 1000;
    motord_claim *claim = NULL;
    motord_state *state = motord_state_new();
    if (motord_connect(argc > 1 ? argv[1] : "demo", &client) != MOTORD_STATUS_OK) return failed("connect");
    if (motord_claim_group(client, group, &claim) != MOTORD_STATUS_OK) return failed("claim");
    if (motord_wait(client, 1000000000, state) != MOTORD_STATUS_OK) return failed("wait");
    struct sigaction action = {0};
    action.sa_handler = handle;
    action.sa_flags = SA_NODEFER;
    sigaction(SIGALRM, &action, NULL);
    sigaction(SIGSEGV, &action, NULL);
    for (int stop = 0; stop < wanted; ++stop) {
        if (stop % 10 == 9) {
            if (sigsetjmp(after_fault, 1) == 0) *(volatile int *)8 = 1;
        } else {
            alarm_soon(stop);
        }
        if (work(claim, state, stop + 1) != EXIT_SUCCESS || check(claim, state) != EXIT_SUCCESS) return EXIT_FAILURE;
    }
    printf("%d stops from signal handlers, %d unconfirmed, %d allocations, errno changed %d times\n", (int)stops,
           (int)unconfirmed, (int)allocations, (int)changed_errno);
    if (unconfirmed) fprintf(stderr, "signals: the last unconfirmed status is %d\n", (int)last);
    motord_claim_free(claim);
    motord_state_free(state);
    motord_client_free(client);
    return unconfirmed || allocations || changed_errno ? EXIT_FAILURE : EXIT_SUCCESS;
}
