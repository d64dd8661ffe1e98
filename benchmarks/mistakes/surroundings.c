/* A clock that jumps and a folder that stalls, for LD_PRELOAD; built by faults_surroundings.py.

   CBOX_CLOCK: every look at the date is up to ten years off, another time than the one before.
   CBOX_STALL: a folder; each opening, writing, renaming, making and removing there, and below the current folder,
   takes 4 ms more, every fiftieth 1 s. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define REAL(result, name, ...)                                                                                        \
    static result (*real)(__VA_ARGS__);                                                                                \
    if (!real) real = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static unsigned looks, calls;

static long jump(void) {
    const long decade = 10L * 365 * 86400;
    if (!getenv("CBOX_CLOCK")) return 0;
    unsigned mixed = (__sync_add_and_fetch(&looks, 1)) * 2654435761u;
    return (long)((double)mixed / 4294967296.0 * 2 * decade) - decade;
}

int clock_gettime(clockid_t clock, struct timespec *at) {
    REAL(int, "clock_gettime", clockid_t, struct timespec *);
    int code = real(clock, at);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) at->tv_sec += jump();
    return code;
}

int gettimeofday(struct timeval *at, void *zone) {
    REAL(int, "gettimeofday", struct timeval *, void *);
    int code = real(at, zone);
    at->tv_sec += jump();
    return code;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}

static void stall(const char *path) {
    const char *slow = getenv("CBOX_STALL");
    if (!slow || !path || (path[0] == '/' && strncmp(path, slow, strlen(slow)))) return;
    usleep(__sync_add_and_fetch(&calls, 1) % 50 ? 4000 : 1000000);
}

static void stall_file(int file) {
    char link[64], path[4096];
    if (!getenv("CBOX_STALL")) return;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 1 || path[0] != '/') return;
    path[length] = 0;
    stall(path);
}

#define OPENING(name)                                                                                                  \
    int name(const char *path, int flags, ...) {                                                                       \
        REAL(int, #name, const char *, int, ...);                                                                      \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = va_arg(rest, int);                                                                               \
        va_end(rest);                                                                                                  \
        stall(path);                                                                                                   \
        return real(path, flags, mode);                                                                                \
    }
OPENING(open)
OPENING(open64)

#define OPENING_AT(name)                                                                                               \
    int name(int folder, const char *path, int flags, ...) {                                                           \
        REAL(int, #name, int, const char *, int, ...);                                                                 \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = va_arg(rest, int);                                                                               \
        va_end(rest);                                                                                                  \
        stall(path);                                                                                                   \
        return real(folder, path, flags, mode);                                                                        \
    }
OPENING_AT(openat)
OPENING_AT(openat64)

int rename(const char *from, const char *to) {
    REAL(int, "rename", const char *, const char *);
    stall(to);
    return real(from, to);
}

int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    stall(path);
    return real(path, mode);
}

int unlink(const char *path) {
    REAL(int, "unlink", const char *);
    stall(path);
    return real(path);
}

ssize_t write(int file, const void *content, size_t size) {
    REAL(ssize_t, "write", int, const void *, size_t);
    stall_file(file);
    return real(file, content, size);
}
