/* What the peers share: round trips between two processes, and their times. */
#ifndef TRIPS_H
#define TRIPS_H
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Trips before those that are timed. */
enum { WARM_UP = 1000 };

static inline double now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e9 * (double)now.tv_sec + (double)now.tv_nsec;
}

static inline void require(int ok, const char *what)
{
    if (!ok) {
        perror(what);
        exit(1);
    }
}

static inline int by_size(const void *a, const void *b)
{
    double difference = *(const double *)a - *(const double *)b;
    return (difference > 0) - (difference < 0);
}

/* Makes `count` round trips by `trip`, and prints the name, the median and the 99 % quantile, ns. */
static inline void time_trips(const char *name, size_t count, void (*trip)(void))
{
    double *times = malloc(count * sizeof *times);
    require(times != NULL, "malloc");
    for (size_t warm = 0; warm < WARM_UP; warm++)
        trip();
    for (size_t place = 0; place < count; place++) {
        double begun = now_ns();
        trip();
        times[place] = now_ns() - begun;
    }
    qsort(times, count, sizeof *times, by_size);
    printf("%s %.0f %.0f\n", name, times[count / 2], times[count * 99 / 100]);
    fflush(stdout);
    free(times);
}
#endif
