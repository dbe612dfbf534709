/* A plugin for qemu-arm: cycles of each call of the library, by block.
 *
 *     qemu-arm -plugin count.so,map=FILE,out=FILE firmware ...
 *
 * The map gives address ranges and their block: "START END BLOCK" in hexadecimal and decimal, BLOCK -1 for functions
 * that are charged to whoever calls them (soft float, memcpy, elementary functions), and two lines "begin ADDRESS" and
 * "end ADDRESS" of the functions that mark a call. Written for each call: 64-bit numbers, cycles of block 0, 1, ... and
 * last the instructions.
 *
 * Costs of the ARM926EJ-S, caches not modelled: 1 cycle; +1 for a use of the value loaded just before; +2 for a taken
 * branch, +4 if it is a load to pc; 3 for a multiplication, 4 for a long one; +1 for a shift by a register; one for
 * each register of ldm and stm. Where it depends on data, the larger number. */
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The part of qemu's plugin interface, version 1, that is used here. */
typedef uint64_t PluginId;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void (*TranslateCallback)(PluginId, struct qemu_plugin_tb *);
typedef void (*ExecuteCallback)(unsigned, void *);
typedef void (*ExitCallback)(PluginId, void *);
void qemu_plugin_register_vcpu_tb_trans_cb(PluginId, TranslateCallback);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *, ExecuteCallback, int, void *);
void qemu_plugin_register_atexit_cb(PluginId, ExitCallback, void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);

#define EXPORTED __attribute__((visibility("default")))
EXPORTED int qemu_plugin_version = 1;

#define BLOCKS_MAX 32
#define RANGES_MAX 8192
#define CALLER (-1)
#define NOWHERE (-2)

typedef struct {
    uint32_t start, end;
    int block;
} AddressRange;

/* A translated piece of code without a branch inside. */
typedef struct {
    uint32_t start, end; /* end: behind its last instruction */
    uint32_t cycles, instructions;
    int block;
    bool begins, ends;
} Piece;

static AddressRange ranges[RANGES_MAX];
static int range_count;
static uint32_t begin_address, end_address;
static FILE *out;
static uint64_t counts[BLOCKS_MAX + 1];
static int blocks, current = NOWHERE;
static bool counting;
static uint32_t expected; /* address of the next instruction if no branch is taken */

/* --- what an instruction costs --- */

static bool is_load(uint32_t op) {
    bool word = (op & 0x0c100000) == 0x04100000;
    bool half = (op & 0x0e100090) == 0x00100090 && (op & 0x60) != 0;
    return word || half;
}

static bool is_block_transfer(uint32_t op) {
    return (op & 0x0e000000) == 0x08000000;
}

static uint32_t cost_of(uint32_t op) {
    if ((op & 0x0fc000f0) == 0x00000090) {
        return 3;
    }
    if ((op & 0x0f8000f0) == 0x00800090) {
        return 4;
    }
    if (is_block_transfer(op)) {
        uint32_t registers = (uint32_t)__builtin_popcount(op & 0xffff);
        bool to_pc = (op & 0x00108000) == 0x00108000;
        return registers + (to_pc ? 2 : 0);
    }
    if (is_load(op)) {
        return (op >> 12 & 15) == 15 ? 3 : 1;
    }
    bool pair = (op & 0x0e1000d0) == 0x000000d0;
    bool shift_by_register = (op & 0x0e000090) == 0x00000010 && (op & 0x0ff000f0) != 0x01200010;
    return pair || shift_by_register ? 2 : 1;
}

/* Whether an instruction may read the register that the one before has loaded. */
static bool uses_loaded(uint32_t before, uint32_t op) {
    uint32_t loaded = before >> 12 & 15;
    return is_load(before) && ((op >> 16 & 15) == loaded || (op & 15) == loaded || (op >> 8 & 15) == loaded);
}

/* --- pieces of code --- */

static int block_of(uint32_t address) {
    int low = 0, high = range_count;
    while (low < high) {
        int middle = (low + high) / 2;
        if (ranges[middle].end <= address) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return low < range_count && ranges[low].start <= address ? ranges[low].block : CALLER;
}

static void finish_call(void) {
    counting = false;
    fwrite(counts, sizeof counts[0], (size_t)blocks, out);
    fwrite(counts + BLOCKS_MAX, sizeof counts[0], 1, out);
}

static void executed(unsigned cpu, void *data) {
    const Piece *piece = data;
    if (cpu != 0) {
        return; /* the camera's thread */
    }
    if (piece->begins) {
        memset(counts, 0, sizeof counts);
        counting = true;
        expected = piece->start;
    }
    if (!counting) {
        return;
    }
    if (piece->ends) {
        finish_call();
        return;
    }
    if (piece->start != expected && current >= 0) {
        counts[current] += 2;
    }
    expected = piece->end;
    current = piece->block >= 0 ? piece->block : current;
    if (current >= 0) {
        counts[current] += piece->cycles;
    }
    counts[BLOCKS_MAX] += piece->instructions;
}

static void translated(PluginId id, struct qemu_plugin_tb *tb) {
    size_t count = qemu_plugin_tb_n_insns(tb);
    Piece *piece = calloc(1, sizeof *piece);
    uint32_t before = 0;
    (void)id;
    for (size_t i = 0; i < count; i++) {
        const struct qemu_plugin_insn *one = qemu_plugin_tb_get_insn(tb, i);
        uint32_t op;
        memcpy(&op, qemu_plugin_insn_data(one), sizeof op);
        piece->cycles += cost_of(op) + (i > 0 && uses_loaded(before, op));
        before = op;
        piece->end = (uint32_t)qemu_plugin_insn_vaddr(one) + 4;
    }
    piece->start = (uint32_t)qemu_plugin_insn_vaddr(qemu_plugin_tb_get_insn(tb, 0));
    piece->instructions = (uint32_t)count;
    piece->block = block_of(piece->start);
    piece->begins = piece->start == begin_address;
    piece->ends = piece->start == end_address;
    qemu_plugin_register_vcpu_tb_exec_cb(tb, executed, 0, piece);
}

/* --- start and end --- */

static void read_map(const char *path) {
    char line[256], word[16];
    FILE *file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file)) {
        AddressRange *one = ranges + range_count;
        uint32_t address;
        if (sscanf(line, "%15s %" SCNx32, word, &address) == 2 && strcmp(word, "begin") == 0) {
            begin_address = address;
        } else if (sscanf(line, "%15s %" SCNx32, word, &address) == 2 && strcmp(word, "end") == 0) {
            end_address = address;
        } else if (range_count < RANGES_MAX &&
                   sscanf(line, "%" SCNx32 " %" SCNx32 " %d", &one->start, &one->end, &one->block) == 3) {
            blocks = one->block >= blocks ? one->block + 1 : blocks;
            range_count++;
        }
    }
    if (file) {
        fclose(file);
    }
}

static void at_exit(PluginId id, void *unused) {
    (void)id;
    (void)unused;
    fclose(out);
}

EXPORTED int qemu_plugin_install(PluginId id, const void *info, int count, char **arguments) {
    (void)info;
    for (int i = 0; i < count; i++) {
        if (strncmp(arguments[i], "map=", 4) == 0) {
            read_map(arguments[i] + 4);
        } else if (strncmp(arguments[i], "out=", 4) == 0) {
            out = fopen(arguments[i] + 4, "wb");
        }
    }
    if (!out || !begin_address || !end_address || blocks > BLOCKS_MAX) {
        fprintf(stderr, "count.so: map=FILE and out=FILE are needed\n");
        return 1;
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, at_exit, NULL);
    return 0;
}
