/* Plain SDO transfers: analyzer folds/sdo/pairs.py. */

#include "kernels.h"

/* Whether the first four bytes of a request and of an answer are those of a plain transfer. */
static int are_plain(uint32_t asked, uint32_t answered)
{
    const int read = (asked & 0xFF) == 0x40 && (answered & 0xE2) == 0x42;
    const int write = (asked & 0xF2) == 0x22 && (answered & 0xE0) == 0x60;
    /* 1200h to 127Fh tell where servers are. */
    return (read || write) && asked >> 8 == answered >> 8 && (asked >> 8 & 0xFF80) != 0x1200;
}

/* Places of the requests and the answers of plain transfers, by the answer's place.
 * length, channel, request: (n,), data: (n, 8), of frames in their order. last: (channels,) all -1,
 * is changed. asks, answers: (n,), of which as many are set as are returned.
 * Returns: how many there are; -1 where a channel is none. */
EXPORT int64_t syncline_sdo_pairs(int64_t n, const uint8_t *length, const uint8_t *data,
                                  const uint16_t *channel, const uint8_t *request, int64_t channels,
                                  int64_t *last, int64_t *asks, int64_t *answers)
{
    int64_t place, found = 0;
    for (place = 0; place < n; place++) {
        int64_t before;
        if (channel[place] >= channels)
            return -1;
        before = last[channel[place]];
        last[channel[place]] = place;
        if (before < 0 || !request[before] || request[place])
            continue;
        if (length[before] != 8 || length[place] != 8)
            continue;
        if (are_plain(u32_at(data + 8 * before), u32_at(data + 8 * place))) {
            asks[found] = before;
            answers[found++] = place;
        }
    }
    return found;
}
