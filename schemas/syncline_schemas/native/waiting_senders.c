/* Who sent the frames of a bus, by their identifiers: analyzer senders.py, waiting_bus.py. */

#include "kernels.h"

#define SHORT_KEYS 4096 /* 11-bit identifiers of data frames, and behind them of remote ones */

/* Place of an identifier of 11 bits in a table of all of them. */
static inline uint32_t short_key(uint32_t can_id, uint16_t flags)
{
    return (can_id & 0x7FF) | (flags & REMOTE ? 0x800u : 0u);
}

/* Which identifiers, (4096,), any frame has whose flags are none of `others`. */
EXPORT int64_t syncline_seen(int64_t n, const uint32_t *can_id, const uint16_t *flags,
                             int64_t others, uint8_t *seen)
{
    int64_t i;
    for (i = 0; i < n; i++)
        if (!(flags[i] & others))
            seen[short_key(can_id[i], flags[i])] = 1;
    return 0;
}

/* Sender of each frame by its identifier, (4096,), and `unknown` for those with such flags. */
EXPORT int64_t syncline_sent_by(int64_t n, const uint32_t *can_id, const uint16_t *flags,
                                int64_t others, const int16_t *sender_of, int64_t unknown,
                                int16_t *sender)
{
    int64_t i;
    for (i = 0; i < n; i++) {
        const int16_t found = sender_of[short_key(can_id[i], flags[i])];
        sender[i] = flags[i] & others ? (int16_t)unknown : found;
    }
    return 0;
}

/* Keys of 11-bit frames, ascending, who sent the last frame of each, and the place of each frame's
 * key among them. place: (n,). keys: (4096,). key_sender: (4096,).
 * Returns: how many there are; -1 where a frame has an identifier of 29 bits. */
EXPORT int64_t syncline_keys(int64_t n, const uint32_t *can_id, const uint16_t *flags,
                             const int16_t *sender, int64_t *place, int64_t *keys,
                             int16_t *key_sender)
{
    int32_t number[SHORT_KEYS] = {0};
    int64_t i, count = 0;
    for (i = 0; i < n; i++) {
        if (flags[i] & EXTENDED)
            return -1;
        place[i] = short_key(can_id[i], flags[i]);
        number[place[i]] = 1;
    }
    for (i = 0; i < SHORT_KEYS; i++) {
        if (!number[i])
            continue;
        keys[count] = (i & 0x7FF) | (i >> 11) << 29;
        number[i] = (int32_t)count++;
    }
    for (i = 0; i < n; i++) {
        place[i] = number[place[i]];
        key_sender[place[i]] = sender[i];
    }
    return count;
}
