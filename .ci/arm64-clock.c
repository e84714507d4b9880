/* A plugin for qemu-user: how many instructions the guest has executed, for the guest to read.
 *
 * Each call of getpriority (141 on arm64) writes the count into the file named by `out`: eight
 * bytes, little-endian. arm64-cost reads it there, as a clock of instructions in place of time.
 * The declarations are those of qemu-plugin.h, which Debian does not ship; API version 1.
 */
#include <fcntl.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
typedef uint64_t plugin_id;
struct tb;
extern size_t qemu_plugin_tb_n_insns(const struct tb *);
extern void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, void (*)(plugin_id, struct tb *));
extern void qemu_plugin_register_vcpu_tb_exec_inline(struct tb *, int op, void *, uint64_t);
extern void qemu_plugin_register_vcpu_syscall_cb(
    plugin_id, void (*)(plugin_id, unsigned, int64_t, uint64_t, uint64_t, uint64_t, uint64_t,
                        uint64_t, uint64_t, uint64_t, uint64_t));

EXPORT int qemu_plugin_version = 1;
enum { ADD_U64 = 0, GETPRIORITY = 141 };
static uint64_t executed;
static int out = -1;

static void translated(plugin_id id, struct tb *tb)
{
    qemu_plugin_register_vcpu_tb_exec_inline(tb, ADD_U64, &executed, qemu_plugin_tb_n_insns(tb));
}

static void called(plugin_id id, unsigned vcpu, int64_t number, uint64_t a, uint64_t b,
                   uint64_t c, uint64_t d, uint64_t e, uint64_t f, uint64_t g, uint64_t h)
{
    if (number == GETPRIORITY && pwrite(out, &executed, sizeof executed, 0) != sizeof executed)
        abort();
}

EXPORT int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv)
{
    if (argc != 1 || strncmp(argv[0], "out=", 4))
        return -1;
    out = open(argv[0] + 4, O_CREAT | O_TRUNC | O_RDWR | O_CLOEXEC, 0644);
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_vcpu_syscall_cb(id, called);
    return out < 0;
}
