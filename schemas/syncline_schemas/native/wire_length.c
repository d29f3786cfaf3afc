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

/* What a header comes to: the CRC of it with the data behind it all 0, and the step behind it. */
struct header {
    uint16_t known, crc, step, unused;
};
/* Of `known`: control bits, and that there are any. */
#define KNOWN 0x100u

static struct header standard_header(const uint16_t *tables, uint32_t id, uint32_t control,
                                     uint32_t payload)
{
    const uint16_t *stuff = tables + STUFF, *crc_of = tables + payload * 256;
    const uint32_t bits = id << 7 | control;
    const uint32_t crc =
        crc_of[512 + (bits >> 16)] ^ crc_of[256 + (bits >> 8 & 0xFF)] ^ crc_of[bits & 0xFF];
    uint32_t step, sum;
    struct header found;
    step = sum = tables[PREFIX_3 + (bits >> 16)];
    WALK(bits >> 8 & 0xFF);
    WALK(bits & 0xFF);
    found.known = (uint16_t)(KNOWN | control);
    found.crc = (uint16_t)crc;
    found.step = (uint16_t)((step & STATES) | (sum & 0xFF));
    found.unused = 0;
    return found;
}

static struct header extended_header(const uint16_t *tables, uint32_t id, uint32_t control,
                                     uint32_t payload)
{
    const uint16_t *stuff = tables + STUFF, *crc_of = tables + payload * 256;
    const uint32_t first = id >> 23 & 0x3F, low = (id & 0x1FF) << 7 | control;
    const uint32_t middle = (id >> 18 & 0x1F) << 11 | 0x600 | (id >> 9 & 0x1FF);
    const uint32_t crc = crc_of[1024 + first] ^ crc_of[768 + (middle >> 8)] ^
                         crc_of[512 + (middle & 0xFF)] ^ crc_of[256 + (low >> 8)] ^
                         crc_of[low & 0xFF];
    uint32_t step, sum;
    struct header found;
    step = sum = tables[PREFIX_7 + first];
    WALK(middle >> 8);
    WALK(middle & 0xFF);
    WALK(low >> 8);
    WALK(low & 0xFF);
    found.known = 0;
    found.crc = (uint16_t)crc;
    found.step = (uint16_t)((step & STATES) | (sum & 0xFF));
    found.unused = 0;
    return found;
}

/* (n,) bits per frame into `out`; 0 for error frames. `data` has `width` >= 8 bytes per frame.
 * tables: CRC-15 of a byte with 0..12 bytes behind it, [13][256]; the step behind a byte by state
 * and byte, [8][256]; behind SOF and 2, and SOF and 6 identifier bits, [4] and [64].
 * headers: [2048], all 0: room for the last header of each 11-bit identifier.
 * Returns the number of CAN FD frames, which are left to the caller: 0 as well. */
EXPORT int64_t syncline_wire_bits(int64_t n, const uint32_t *can_id, const uint16_t *flags,
                                  const uint8_t *dlc, const uint8_t *data, int64_t width,
                                  const uint16_t *tables, struct header *headers,
                                  int64_t intermission, uint16_t *out)
{
    const uint16_t *stuff = tables + STUFF;
    int64_t fd = 0, i;
    for (i = 0; i < n; i++) {
        const uint8_t *bytes = data + i * width;
        const uint32_t flag = flags[i], length = dlc[i] < 8 ? dlc[i] : 8;
        const uint32_t remote = (flag & REMOTE) != 0, payload = remote ? 0 : length;
        const uint32_t control = remote << 6 | length, id = can_id[i];
        const struct header *header;
        struct header other;
        uint32_t crc, step, sum, bits = TRAILER_BITS + CRC_BITS + 8 * payload, k;
        if (flag & (FD | ERROR_FRAME)) {
            fd += (flag & ERROR_FRAME) == 0;
            out[i] = 0;
            continue;
        }
        if (flag & EXTENDED) {
            bits += EXTENDED_HEADER_BITS;
            other = extended_header(tables, id, control, payload);
            header = &other;
        } else {
            struct header *const last = headers + (id & 0x7FF);
            bits += STANDARD_HEADER_BITS;
            if (last->known != (KNOWN | control))
                *last = standard_header(tables, id & 0x7FF, control, payload);
            header = last;
        }
        crc = header->crc;
        step = sum = header->step;
        for (k = 0; k < payload; k++) {
            crc ^= tables[256 * (payload - 1 - k) + bytes[k]];
            WALK(bytes[k]);
        }
        /* The CRC in 15 bits, and one more that makes no stuff bit. */
        crc = crc << 1 | (~crc & 1);
        WALK(crc >> 8);
        WALK(crc & 0xFF);
        out[i] = (uint16_t)(bits + (sum & 0xFF) + (uint32_t)intermission);
    }
    return fd;
}
