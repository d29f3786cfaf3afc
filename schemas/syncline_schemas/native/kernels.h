/* The dearest loops of reading, indexing and analyzing frames.
 *
 * Each function has a twin in numpy whose results it equals bit for bit: the Python module that
 * calls it holds both. Numbers in files are little-endian, as is the machine: on others this
 * library is not loaded. Nothing is read or written outside the lengths given, whatever the bytes
 * say. C99; no state, no memory of their own.
 */

#ifndef SYNCLINE_KERNELS_H
#define SYNCLINE_KERNELS_H

#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* FrameFlag */
#define EXTENDED 0x01u
#define REMOTE 0x02u
#define ERROR_FRAME 0x04u
#define FD 0x08u

static inline uint16_t u16_at(const uint8_t *at)
{
    uint16_t value;
    memcpy(&value, at, sizeof value);
    return value;
}

static inline uint32_t u32_at(const uint8_t *at)
{
    uint32_t value;
    memcpy(&value, at, sizeof value);
    return value;
}

static inline uint64_t u64_at(const uint8_t *at)
{
    uint64_t value;
    memcpy(&value, at, sizeof value);
    return value;
}

#endif
