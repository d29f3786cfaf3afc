/* 11-bit frames in order by bus and identifier: analyzer grouping.py. */

#include "kernels.h"

#define REMOTE_KEY 0x800u
#define BUS_SHIFT 12
#define MOST_LENGTH 255

/* What is known of a key: how many frames, then where the next one goes; and their lengths. */
struct place {
    uint32_t count;
    uint8_t longest, below;
    uint16_t unused;
};

static inline uint32_t key_of(uint32_t can_id, uint32_t bus, uint32_t flags)
{
    return can_id | bus << BUS_SHIFT | (flags & REMOTE ? REMOTE_KEY : 0);
}

/* Rows and stamps of the frames without `unwanted` flags by key, in arrival order within each.
 * places: (keys,) zeros. rows, ordered_ns: (n,). edges: (min(n, keys) + 1,); key, shortest and
 * longest length of each group: (min(n, keys),).
 * Returns: the number of groups; -1 where a key is `keys` or more. */
EXPORT int64_t syncline_grouping(int64_t n, const uint32_t *can_id, const uint8_t *bus,
                                 const uint16_t *flags, const uint8_t *dlc, const int64_t *t_ns,
                                 uint32_t unwanted, int64_t keys, struct place *places,
                                 int64_t *rows, int64_t *ordered_ns, uint32_t *key,
                                 int64_t *edges, uint8_t *shortest, uint8_t *longest)
{
    int64_t i, groups = 0, begin = 0, k;
    for (i = 0; i < n; i++) {
        const uint32_t each = key_of(can_id[i], bus[i], flags[i]);
        const uint8_t length = dlc[i], below = (uint8_t)(MOST_LENGTH - length);
        struct place *place;
        if (flags[i] & unwanted)
            continue;
        if ((int64_t)each >= keys)
            return -1;
        place = places + each;
        place->count++;
        if (length > place->longest)
            place->longest = length;
        if (below > place->below)
            place->below = below;
    }
    edges[0] = 0;
    for (k = 0; k < keys; k++) {
        const int64_t count = places[k].count;
        if (count == 0)
            continue;
        places[k].count = (uint32_t)begin;
        key[groups] = (uint32_t)k;
        shortest[groups] = (uint8_t)(MOST_LENGTH - places[k].below);
        longest[groups] = places[k].longest;
        begin += count;
        edges[++groups] = begin;
    }
    for (i = 0; i < n; i++) {
        if (!(flags[i] & unwanted)) {
            const int64_t to = places[key_of(can_id[i], bus[i], flags[i])].count++;
            rows[to] = i;
            ordered_ns[to] = t_ns[i];
        }
    }
    return groups;
}

/* Places whose stamp comes at most `limit` after the one before it in the same group, and not before.
 * t_ns, found: (n,). edges: (groups + 1,), ascending.
 * Returns: how many there are; -1 where an edge is none of the column. */
EXPORT int64_t syncline_soon(int64_t n, const int64_t *t_ns, int64_t groups, const int64_t *edges,
                             int64_t limit, int64_t *found)
{
    int64_t count = 0, group, i;
    for (group = 0; group < groups; group++) {
        const int64_t begin = edges[group], stop = edges[group + 1];
        if (begin < 0 || stop < begin || stop > n)
            return -1;
        for (i = begin + 1; i < stop; i++)
            /* A negative distance is a large unsigned one. */
            if ((uint64_t)t_ns[i] - (uint64_t)t_ns[i - 1] <= (uint64_t)limit)
                found[count++] = i;
    }
    return count;
}
