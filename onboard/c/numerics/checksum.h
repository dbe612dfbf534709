/* CRC-32 and Adler-32 as zlib computes them. */
#ifndef DMRAC_CHECKSUM_H
#define DMRAC_CHECKSUM_H

#include <stddef.h>
#include <stdint.h>

/* Checksums of more bytes, after those so far: zlib.crc32(bytes, crc) and zlib.adler32(bytes, adler). The first ones: 0 and 1. */
uint32_t crc32_of(const uint8_t *bytes, size_t size, uint32_t crc);
uint32_t adler32_of(const uint8_t *bytes, size_t size, uint32_t adler);

#endif
