/* Loaded before the C library (LD_PRELOAD): the wall clock is set as an NTP daemon without patience does it. After 1.5 s it is an hour
 * fast, after 3 s an hour slow. At the end the file named by CLOCK_STEP_LOG tells how often the program asked for it. */
#include <stdio.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static struct timespec began;
static long asked, asked_stepped;

int clock_gettime(clockid_t clock, struct timespec *at)
{
    int result = syscall(SYS_clock_gettime, clock, at);
    if (result != 0 || clock != CLOCK_REALTIME)
        return result;
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
    if (began.tv_sec == 0)
        began = now;
    double since = (double)(now.tv_sec - began.tv_sec) + 1e-9 * (double)(now.tv_nsec - began.tv_nsec);
    asked++;
    if (since > 1.5) {
        asked_stepped++;
        at->tv_sec += since > 3.0 ? -3600 : 3600;
    }
    return 0;
}

__attribute__((destructor)) static void tell(void)
{
    const char *path = getenv("CLOCK_STEP_LOG");
    FILE *file = path ? fopen(path, "w") : NULL;
    if (file) {
        fprintf(file, "%ld %ld\n", asked, asked_stepped);
        fclose(file);
    }
}
