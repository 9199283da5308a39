// block-thread THREAD SECONDS: stops one thread of a process, as a debugger does, and lets it continue.
//
// Prints the time at which the thread stops, in seconds since 1970.
#include <stdio.h>
#include <stdlib.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

int main(int count, char **arguments) {
    if (count != 3) return 64;
    pid_t thread = atoi(arguments[1]);
    struct timespec now;
    if (ptrace(PTRACE_SEIZE, thread, 0, 0) || ptrace(PTRACE_INTERRUPT, thread, 0, 0) || waitpid(thread, 0, __WALL) < 0) {
        perror("block-thread");
        return 1;
    }
    clock_gettime(CLOCK_REALTIME, &now);
    printf("%lld.%06ld\n", (long long)now.tv_sec, now.tv_nsec / 1000);
    fflush(stdout);
    usleep((useconds_t)(1e6 * atof(arguments[2])));
    return ptrace(PTRACE_DETACH, thread, 0, 0) ? 1 : 0;
}
