#include "atomic.h"

#if defined(__arm__)

/* One core needs no instruction for it: the compiler alone might change the order. */
void atomic_barrier(void) {
    __asm__ volatile("" ::: "memory");
}

bool atomic_take(volatile int32_t *flag) {
    int32_t before, one = 1;
    __asm__ volatile("swp %0, %1, [%2]" : "=&r"(before) : "r"(one), "r"(flag) : "memory");
    return before == 0;
}

#else

void atomic_barrier(void) {
    __sync_synchronize();
}

bool atomic_take(volatile int32_t *flag) {
    return __sync_lock_test_and_set(flag, 1) == 0;
}

#endif

void atomic_give_back(volatile int32_t *flag) {
    atomic_barrier();
    *flag = 0;
}
