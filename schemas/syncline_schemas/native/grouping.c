/* 11-bit frames in order by bus and identifier: analyzer grouping.py. */

#include "kernels.h"

#define REMOTE_KEY 0x800u
#define BUS_SHIFT 12

static inline uint32_t key_of(uint32_t can_id, uint32_t bus, uint32_t flags)
{
    return can_id | bus << BUS_SHIFT | (flags & REMOTE ? REMOTE_KEY : 0);
}

/* Rows of the frames without `unwanted` flags by key, in arrival order within each.
 * places: (keys,) zeros. rows, key: (n,). edges: (min(n, keys) + 1,).
 * Returns: the number of groups; -1 where a key is `keys` or more. */
EXPORT int64_t syncline_grouping(int64_t n, const uint32_t *can_id, const uint8_t *bus,
                                 const uint16_t *flags, uint32_t unwanted, int64_t keys,
                                 uint32_t *places, int64_t *rows, uint32_t *key, int64_t *edges)
{
    int64_t i, groups = 0, begin = 0, k;
    for (i = 0; i < n; i++) {
        const uint32_t each = key_of(can_id[i], bus[i], flags[i]);
        if (flags[i] & unwanted)
            continue;
        if ((int64_t)each >= keys)
            return -1;
        places[each]++;
    }
    edges[0] = 0;
    for (k = 0; k < keys; k++) {
        const int64_t count = places[k];
        if (count == 0)
            continue;
        places[k] = (uint32_t)begin;
        for (i = 0; i < count; i++)
            key[begin + i] = (uint32_t)k;
        begin += count;
        edges[++groups] = begin;
    }
    for (i = 0; i < n; i++)
        if (!(flags[i] & unwanted))
            rows[places[key_of(can_id[i], bus[i], flags[i])]++] = i;
    return groups;
}
