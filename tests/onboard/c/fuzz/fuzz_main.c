/* Runs a fuzz target without libFuzzer: with the files given, or with inputs that it makes itself from a seed.
 *
 *     link_fuzz FILE...
 *     link_fuzz --datagrams COUNT --seed SEED
 *
 * Inputs are random bytes, or changed copies of earlier inputs. When a check fails, the input is written to the file
 * `last_input`, which `link_fuzz last_input` runs again. So is that of a sanitizer's fault, with ASAN_OPTIONS and
 * UBSAN_OPTIONS set to abort_on_error=1:handle_abort=0.
 */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "link_target.h"

#define INPUT_MAX 8192
#define POOL 64

static uint8_t input[INPUT_MAX];
static size_t input_size;

/* A generator of Marsaglia (xorshift64*) */
static uint64_t random_number(uint64_t *state) {
    *state ^= *state >> 12;
    *state ^= *state << 25;
    *state ^= *state >> 27;
    return *state * UINT64_C(2685821657736338717);
}

static uint64_t below(uint64_t *state, uint64_t limit) {
    return (random_number(state) >> 16) % limit;
}

static void save(int signal_number) {
    FILE *file = fopen("last_input", "wb");
    if (file != NULL) {
        fwrite(input, 1, input_size, file);
        fclose(file);
    }
    signal(signal_number, SIG_DFL);
    raise(signal_number);
}

static int run_file(const char *path) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        fprintf(stderr, "%s cannot be read\n", path);
        return 1;
    }
    input_size = fread(input, 1, sizeof input, file);
    fclose(file);
    return LLVMFuzzerTestOneInput(input, input_size);
}

/* Bytes changed, and a part copied to another place */
static void change(uint64_t *state) {
    for (uint64_t count = 1 + below(state, 20); count > 0 && input_size > 0; count--) {
        input[below(state, input_size)] = (uint8_t)random_number(state);
    }
    if (input_size > 1) {
        size_t from = below(state, input_size), to = below(state, input_size), size = below(state, 64);
        size_t most = input_size - (from > to ? from : to);
        memmove(input + to, input + from, size < most ? size : most);
    }
}

static void run_many(uint64_t datagrams, uint64_t seed) {
    static uint8_t pool[POOL][INPUT_MAX];
    static size_t sizes[POOL];
    uint64_t state = seed * UINT64_C(0x9e3779b97f4a7c15) + 1, inputs = 0;
    for (; target_counts.datagrams < datagrams; inputs++) {
        size_t place = below(&state, POOL);
        if (sizes[place] > 0 && below(&state, 2) == 0) {
            input_size = sizes[place];
            memcpy(input, pool[place], input_size);
            change(&state);
        } else {
            input_size = below(&state, 8) == 0 ? INPUT_MAX : below(&state, 2000);
            for (size_t i = 0; i < input_size; i++) {
                input[i] = (uint8_t)(random_number(&state) >> 32);
            }
        }
        LLVMFuzzerTestOneInput(input, input_size);
        place = below(&state, POOL);
        memcpy(pool[place], input, input_size);
        sizes[place] = input_size;
    }
    printf("inputs %llu\n", (unsigned long long)inputs);
}

static void report(void) {
    static const char *const names[7] = {"datagrams", "accepted", "poses", "chunks", "restarts", "sent", "duplicate"};
    const uint64_t counts[7] = {target_counts.datagrams, target_counts.accepted, target_counts.poses,
                                target_counts.chunks,    target_counts.restarts, target_counts.sent,
                                target_counts.duplicate};
    for (int i = 0; i < 7; i++) {
        printf("%s %llu\n", names[i], (unsigned long long)counts[i]);
    }
    for (int i = 1; i < REJECTION_COUNT; i++) {
        printf("rejected_%d %llu\n", i, (unsigned long long)target_counts.rejected[i]);
    }
}

int main(int argc, char **argv) {
    signal(SIGABRT, save);
    if (argc == 5 && strcmp(argv[1], "--datagrams") == 0 && strcmp(argv[3], "--seed") == 0) {
        run_many(strtoull(argv[2], NULL, 10), strtoull(argv[4], NULL, 10));
        report();
        return 0;
    }
    if (argc < 2 || argv[1][0] == '-') {
        fprintf(stderr, "usage: %s FILE... | --datagrams COUNT --seed SEED\n", argv[0]);
        return 2;
    }
    for (int i = 1; i < argc; i++) {
        int failed = run_file(argv[i]);
        if (failed != 0) {
            return failed;
        }
    }
    report();
    return 0;
}
