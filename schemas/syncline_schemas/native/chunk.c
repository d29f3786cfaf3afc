/* Frames out of the messages of a chunk: capture/chunk_group.py, frame_record.py. */

#include "kernels.h"

/* Kind of a channel (capture/channels.py) */
#define KIND_FRAME 1
#define KIND_STATUS 3
#define KIND_CLOCK 4
#define KIND_OTHER 5
#define KIND_MARK 6

#define RECORD_HEAD 31
#define FRAME_HEAD 45
#define MAX_DATA 64

/* From byte 31 on: tag of the identifier, its four bytes, of which the highest three bits are 0, tag
 * of the flags, two bytes of them. From byte 37 on: the flags, of which the higher two bytes are 0,
 * tag of the length, length, tag of the data, their number. */
#define FIXED_31 0x0000FFE0000000FFull
#define TAGS_31 0x000015000000000Dull
#define FIXED_37 0x00FF00FFFFFF0000ull
#define TAGS_37 0x0022001800000000ull

#define PLAIN 0
#define NOT_PLAIN 1
#define TOO_WIDE 2

struct columns {
    int64_t width, capacity, *t_ns, *log_time_ns;
    uint8_t *bus;
    uint32_t *can_id;
    uint16_t *flags;
    uint8_t *dlc, *data;
};

/* Put the frame of a message record into a row, where it is one in the one form in which pack_frames
 * writes it; `left` bytes are readable from the record on. */
static inline int64_t put(const struct columns *to, int64_t row, const uint8_t *record,
                          uint64_t left, int16_t bus)
{
    uint32_t bytes, dlc;
    if (left < FRAME_HEAD || row >= to->capacity)
        return NOT_PLAIN;
    if ((u64_at(record + 31) & FIXED_31) != TAGS_31 || (u64_at(record + 37) & FIXED_37) != TAGS_37)
        return NOT_PLAIN;
    bytes = record[44], dlc = record[42];
    if (dlc > MAX_DATA || bytes != (record[37] & REMOTE ? 0 : dlc))
        return NOT_PLAIN;
    if (u64_at(record + 1) != bytes + (FRAME_HEAD - 9))
        return NOT_PLAIN;
    if (bytes > to->width)
        return TOO_WIDE;
    to->t_ns[row] = (int64_t)u64_at(record + 23);
    to->log_time_ns[row] = (int64_t)u64_at(record + 15);
    to->bus[row] = (uint8_t)bus;
    to->can_id[row] = u32_at(record + 32);
    to->flags[row] = u16_at(record + 37);
    to->dlc[row] = (uint8_t)dlc;
    if (to->width == 8 && left >= FRAME_HEAD + 8) {
        /* A shift by 64 is undefined. */
        const uint64_t kept = bytes == 8 ? ~(uint64_t)0 : ((uint64_t)1 << 8 * bytes) - 1;
        const uint64_t word = u64_at(record + FRAME_HEAD) & kept;
        memcpy(to->data + 8 * row, &word, 8);
    } else {
        memset(to->data + to->width * row, 0, (size_t)to->width);
        memcpy(to->data + to->width * row, record + FRAME_HEAD, bytes);
    }
    return PLAIN;
}

/* The frames of a chunk as columns from row `row` on, with `width` bytes of data (8 or 64), and
 * where the messages of bus states, clocks and marks are.
 * kind, bus_of_channel: (65536,) by channel id. The columns have `capacity` rows, `others` has
 * `other_capacity` rows of offset, end, channel and log time.
 * told: frames, others, log time of the first message and of the last.
 * Returns: TOO_WIDE where a frame has more bytes of data than `width`; NOT_PLAIN where anything
 * else is in the chunk than whole messages of known channels without gaps, all frames as
 * pack_frames writes them. What was written then counts for nothing. */
EXPORT int64_t syncline_chunk_frames(const uint8_t *chunk, int64_t size, const uint8_t *kind,
                                     const int16_t *bus_of_channel, int64_t width,
                                     int64_t capacity, int64_t row, int64_t *t_ns,
                                     int64_t *log_time_ns, uint8_t *bus, uint32_t *can_id,
                                     uint16_t *flags, uint8_t *dlc, uint8_t *data,
                                     int64_t other_capacity, int64_t *others, int64_t *told)
{
    const struct columns to = {width, capacity, t_ns,  log_time_ns, bus,
                               can_id, flags,   dlc, data};
    const int64_t first_row = row;
    int64_t at = 0, other = 0, last_at = 0;
    while (at < size) {
        const uint8_t *record = chunk + at;
        const uint64_t left = (uint64_t)(size - at);
        uint64_t length;
        uint32_t channel;
        if (left < RECORD_HEAD || record[0] != 0x05)
            return NOT_PLAIN;
        length = u64_at(record + 1);
        if (length < RECORD_HEAD - 9 || length > left - 9)
            return NOT_PLAIN;
        channel = u16_at(record + 9);
        if (kind[channel] == KIND_FRAME) {
            const int64_t found = put(&to, row, record, left, bus_of_channel[channel]);
            if (found != PLAIN)
                return found;
            row++;
        } else if (kind[channel] == KIND_STATUS || kind[channel] == KIND_CLOCK ||
                   kind[channel] == KIND_MARK) {
            if (other >= other_capacity)
                return NOT_PLAIN;
            others[4 * other] = at;
            others[4 * other + 1] = at + 9 + (int64_t)length;
            others[4 * other + 2] = channel;
            others[4 * other + 3] = (int64_t)u64_at(record + 15);
            other++;
        } else if (kind[channel] != KIND_OTHER) {
            return NOT_PLAIN;
        }
        last_at = at;
        at += 9 + (int64_t)length;
    }
    if (size <= 0)
        return NOT_PLAIN;
    told[0] = row - first_row;
    told[1] = other;
    told[2] = (int64_t)u64_at(chunk + 15);
    told[3] = (int64_t)u64_at(chunk + last_at + 15);
    return PLAIN;
}
