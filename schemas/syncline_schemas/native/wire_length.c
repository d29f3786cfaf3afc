/* Lengths on the wire: wire_length.py. */

#include "kernels.h"

#define TRAILER_BITS 10
#define CRC_BITS 15
#define STANDARD_HEADER_BITS 19
#define EXTENDED_HEADER_BITS 39

/* Where the tables begin, in numbers of 16 bits. A step is state << 8 | stuff bits. */
#define STUFF (13 * 256)
#define PREFIX_3 (STUFF + 8 * 256)
#define PREFIX_7 (PREFIX_3 + 4)
#define STATES 0x700u

/* One more byte: the step behind it, and the stuff bits so far in the lower byte of `sum`. */
#define WALK(byte)                                                                               \
    do {                                                                                         \
        step = stuff[(step & STATES) | (byte)];                                                  \
        sum += step;                                                                             \
    } while (0)

/* (n,) bits per frame into `out`; 0 for error frames. `data` has `width` >= 8 bytes per frame.
 * tables: CRC-15 of a byte with 0..12 bytes behind it, [13][256]; the step behind a byte by state
 * and byte, [8][256]; behind SOF and 2, and SOF and 6 identifier bits, [4] and [64].
 * Returns the number of CAN FD frames, which are left to the caller: 0 as well. */
EXPORT int64_t syncline_wire_bits(int64_t n, const uint32_t *can_id, const uint16_t *flags,
                                  const uint8_t *dlc, const uint8_t *data, int64_t width,
                                  const uint16_t *tables, int64_t intermission, int64_t *out)
{
    const uint16_t *stuff = tables + STUFF;
    int64_t fd = 0, i;
    for (i = 0; i < n; i++) {
        const uint8_t *bytes = data + i * width;
        const uint32_t flag = flags[i], length = dlc[i] < 8 ? dlc[i] : 8;
        const uint32_t remote = (flag & REMOTE) != 0, payload = remote ? 0 : length;
        const uint32_t control = remote << 6 | length, id = can_id[i];
        const uint16_t *crc_of = tables + payload * 256;
        uint32_t crc, step, sum, bits = TRAILER_BITS + CRC_BITS + 8 * payload, k;
        if (flag & (FD | ERROR_FRAME)) {
            fd += (flag & ERROR_FRAME) == 0;
            out[i] = 0;
            continue;
        }
        if (flag & EXTENDED) {
            const uint32_t first = id >> 23 & 0x3F, low = (id & 0x1FF) << 7 | control;
            const uint32_t middle = (id >> 18 & 0x1F) << 11 | 0x600 | (id >> 9 & 0x1FF);
            bits += EXTENDED_HEADER_BITS;
            crc = crc_of[1024 + first] ^ crc_of[768 + (middle >> 8)] ^
                  crc_of[512 + (middle & 0xFF)] ^ crc_of[256 + (low >> 8)] ^ crc_of[low & 0xFF];
            step = sum = tables[PREFIX_7 + first];
            WALK(middle >> 8);
            WALK(middle & 0xFF);
            WALK(low >> 8);
            WALK(low & 0xFF);
        } else {
            const uint32_t header = (id & 0x7FF) << 7 | control;
            bits += STANDARD_HEADER_BITS;
            crc = crc_of[512 + (header >> 16)] ^ crc_of[256 + (header >> 8 & 0xFF)] ^
                  crc_of[header & 0xFF];
            step = sum = tables[PREFIX_3 + (header >> 16)];
            WALK(header >> 8 & 0xFF);
            WALK(header & 0xFF);
        }
        for (k = 0; k < payload; k++) {
            crc ^= tables[256 * (payload - 1 - k) + bytes[k]];
            WALK(bytes[k]);
        }
        /* The CRC in 15 bits, and one more that makes no stuff bit. */
        crc = crc << 1 | (~crc & 1);
        WALK(crc >> 8);
        WALK(crc & 0xFF);
        out[i] = (int64_t)(bits + (sum & 0xFF)) + intermission;
    }
    return fd;
}
