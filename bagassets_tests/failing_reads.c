/* Preloaded into a process, this has one of its reads of files below a folder fail with EIO: opening, listing, reading, mapping. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/uio.h>
#include <unistd.h>

static char root[4096], failed[8192];
static long count, fails_at;

/* Begin to count, below a folder; the n-th read fails, none if n is 0. */
void begin_reads(const char *folder, long n) {
    snprintf(root, sizeof root, "%s/", folder);
    count = 0, fails_at = n, failed[0] = 0;
}
long reads_so_far(void) { return count; }
const char *failed_read(void) { return failed; }

static int fails_path(const char *what, const char *path) {
    if (!root[0] || strncmp(path, root, strlen(root)) || __atomic_add_fetch(&count, 1, __ATOMIC_SEQ_CST) != fails_at) return 0;
    snprintf(failed, sizeof failed, "%s %s", what, path + strlen(root));
    errno = EIO;
    return 1;
}
static int fails(const char *what, int descriptor) {
    char link[64], path[4096];
    if (!root[0] || descriptor < 0) return 0;
    int saved = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t size = readlink(link, path, sizeof path - 1);
    errno = saved;
    if (size <= 0) return 0;
    path[size] = 0;
    return fails_path(what, path);
}
#define NEXT(name) static __typeof__(&name) next; if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int opened(int descriptor, int flags) {
    if (descriptor >= 0 && (flags & O_ACCMODE) != O_WRONLY && !(flags & O_PATH) && fails("open", descriptor)) {
        close(descriptor);
        errno = EIO;
        return -1;
    }
    return descriptor;
}
#define MODE(flags) int mode = 0; if (flags & (O_CREAT | __O_TMPFILE)) { va_list all; va_start(all, flags); mode = va_arg(all, int); va_end(all); }
#define OPEN(name) int name(const char *path, int flags, ...) { NEXT(name); MODE(flags) return opened(next(path, flags, mode), flags); }
#define OPENAT(name) int name(int at, const char *path, int flags, ...) { NEXT(name); MODE(flags) return opened(next(at, path, flags, mode), flags); }
OPEN(open) OPEN(open64) OPENAT(openat) OPENAT(openat64)

#define FOPEN(name) FILE *name(const char *path, const char *mode) { \
    NEXT(name); FILE *file = next(path, mode); \
    if (file && mode[0] == 'r' && fails("open", fileno(file))) { fclose(file); errno = EIO; return NULL; } \
    return file; }
FOPEN(fopen) FOPEN(fopen64)

DIR *opendir(const char *path) {
    NEXT(opendir);
    DIR *found = next(path);
    if (found && fails("list", dirfd(found))) { closedir(found); errno = EIO; return NULL; }
    return found;
}
ssize_t read(int descriptor, void *buffer, size_t size) {
    NEXT(read);
    return fails("read", descriptor) ? -1 : next(descriptor, buffer, size);
}
ssize_t readv(int descriptor, const struct iovec *parts, int number) {
    NEXT(readv);
    return fails("read", descriptor) ? -1 : next(descriptor, parts, number);
}
#define PREAD(name, offset_t) ssize_t name(int descriptor, void *buffer, size_t size, offset_t at) { \
    NEXT(name); return fails("read", descriptor) ? -1 : next(descriptor, buffer, size, at); }
PREAD(pread, off_t) PREAD(pread64, off64_t)
#define PREADV(name, offset_t) ssize_t name(int descriptor, const struct iovec *parts, int number, offset_t at) { \
    NEXT(name); return fails("read", descriptor) ? -1 : next(descriptor, parts, number, at); }
PREADV(preadv, off_t) PREADV(preadv64, off64_t)
#define PREADV2(name, offset_t) ssize_t name(int descriptor, const struct iovec *parts, int number, offset_t at, int flags) { \
    NEXT(name); return fails("read", descriptor) ? -1 : next(descriptor, parts, number, at, flags); }
PREADV2(preadv2, off_t) PREADV2(preadv64v2, off64_t)
#define MMAP(name, offset_t) void *name(void *where, size_t size, int protection, int flags, int descriptor, offset_t at) { \
    NEXT(name); return fails("map", descriptor) ? MAP_FAILED : next(where, size, protection, flags, descriptor, at); }
MMAP(mmap, off_t) MMAP(mmap64, off64_t)
ssize_t sendfile(int target, int source, off_t *at, size_t size) {
    NEXT(sendfile);
    return fails("read", source) ? -1 : next(target, source, at, size);
}
