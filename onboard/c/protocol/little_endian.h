/* Numbers in bytes, the least significant byte first, whatever the machine has. */
#ifndef DMRAC_LITTLE_ENDIAN_H
#define DMRAC_LITTLE_ENDIAN_H

#include <stdint.h>

uint64_t read_u64(const uint8_t *bytes);
void write_u64(uint8_t *bytes, uint64_t value);
/* IEEE 754 binary32. */
float read_f32(const uint8_t *bytes);
void write_f32(uint8_t *bytes, float value);

#endif
