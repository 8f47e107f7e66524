/* Ends a process at its call number FARHORIZON_DIE of those that change files below FARHORIZON_UNDER; a write is half done by then if FARHORIZON_HALF.
   Preloaded (LD_PRELOAD); farhorizon_calls is their number so far. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

long farhorizon_calls = 0;

static int below(const char *path) {
    const char *under = getenv("FARHORIZON_UNDER");
    char full[8192];
    if (!under || !path) return 0;
    if (path[0] != '/') {
        if (!getcwd(full, 4096)) return 0;
        strncat(full, "/", 2);
        strncat(full, path, 4000);
        path = full;
    }
    return strncmp(path, under, strlen(under)) == 0;
}

static int ours(int descriptor) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path);
}

static int dies(void) {
    const char *when = getenv("FARHORIZON_DIE");
    farhorizon_calls++;
    return when && farhorizon_calls == atol(when);
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

ssize_t write(int d, const void *data, size_t n) {
    REAL(write);
    if (ours(d) && dies()) { if (getenv("FARHORIZON_HALF")) real(d, data, n / 2); _exit(137); }
    return real(d, data, n);
}

static ssize_t at(const char *name, int d, const void *data, size_t n, off_t o) {
    ssize_t (*real)(int, const void *, size_t, off_t) = (ssize_t (*)(int, const void *, size_t, off_t))dlsym(RTLD_NEXT, name);
    if (ours(d) && dies()) { if (getenv("FARHORIZON_HALF")) real(d, data, n / 2, o); _exit(137); }
    return real(d, data, n, o);
}
ssize_t pwrite(int d, const void *data, size_t n, off_t o) { return at("pwrite", d, data, n, o); }
ssize_t pwrite64(int d, const void *data, size_t n, off_t o) { return at("pwrite64", d, data, n, o); }

ssize_t writev(int d, const struct iovec *v, int n) {
    REAL(writev);
    if (ours(d) && dies()) _exit(137);
    return real(d, v, n);
}

static int of_descriptor(const char *name, int d, off_t n) {
    int (*real)(int, off_t) = (int (*)(int, off_t))dlsym(RTLD_NEXT, name);
    if (ours(d) && dies()) _exit(137);
    return real(d, n);
}
int ftruncate(int d, off_t n) { return of_descriptor("ftruncate", d, n); }
int ftruncate64(int d, off_t n) { return of_descriptor("ftruncate64", d, n); }
int fsync(int d) {
    REAL(fsync);
    if (ours(d) && dies()) _exit(137);
    return real(d);
}

static int of_path(const char *name, const char *path, off_t n) {
    int (*real)(const char *, off_t) = (int (*)(const char *, off_t))dlsym(RTLD_NEXT, name);
    if (below(path) && dies()) _exit(137);
    return real(path, n);
}
int truncate(const char *path, off_t n) { return of_path("truncate", path, n); }
int truncate64(const char *path, off_t n) { return of_path("truncate64", path, n); }

int unlink(const char *path) {
    REAL(unlink);
    if (below(path) && dies()) _exit(137);
    return real(path);
}
int unlinkat(int folder, const char *path, int flags) {
    REAL(unlinkat);
    if ((folder == AT_FDCWD ? below(path) : ours(folder)) && dies()) _exit(137);
    return real(folder, path, flags);
}
int rename(const char *from, const char *to) {
    REAL(rename);
    if (below(to) && dies()) _exit(137);
    return real(from, to);
}
int renameat(int a, const char *from, int b, const char *to) {
    REAL(renameat);
    if ((b == AT_FDCWD ? below(to) : ours(b)) && dies()) _exit(137);
    return real(a, from, b, to);
}
int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    if (below(path) && dies()) _exit(137);
    return real(path, mode);
}

static int opened(const char *name, const char *path, int flags, mode_t mode) {
    int (*real)(const char *, int, mode_t) = (int (*)(const char *, int, mode_t))dlsym(RTLD_NEXT, name);
    if ((flags & (O_CREAT | O_TRUNC)) && below(path) && dies()) _exit(137);
    return real(path, flags, mode);
}
#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list more; va_start(more, flags); mode_t mode = (flags & O_CREAT) ? va_arg(more, mode_t) : 0; va_end(more); \
        return opened(#name, path, flags, mode); }
OPEN(open)
OPEN(open64)
