/* Columns by identifier, where the frames of each are a place: analyzer fold.py, pdo_columns.py.
 *
 * places: (p, 2) where each begins and stops in the columns, ascending, none of them empty. The
 * Python side has checked that the last one stops within them.
 */

#include "kernels.h"

/* A difference as numpy tells it, where it is too large. */
static inline int64_t less(int64_t one, int64_t other)
{
    return (int64_t)((uint64_t)one - (uint64_t)other);
}

/* Rows, positions of the SYNC before and the time since it, of all frames by identifier.
 * before: (n,) position by row. t_ns: (k,) by identifier. sync_ns: (m,) by position.
 * Returns: 0; -1 where a row or a position is none. */
EXPORT int64_t syncline_since(int64_t k, const int64_t *rows, const int64_t *t_ns, int64_t n,
                              const int64_t *before, int64_t m, const int64_t *sync_ns,
                              int64_t *before_by_id, int64_t *since_by_id)
{
    int64_t i;
    for (i = 0; i < k; i++) {
        int64_t at;
        if ((uint64_t)rows[i] >= (uint64_t)n)
            return -1;
        at = before[rows[i]];
        if ((uint64_t)at >= (uint64_t)m)
            return -1;
        before_by_id[i] = at;
        since_by_id[i] = less(t_ns[i], sync_ns[at]);
    }
    return 0;
}

/* Number of the SYNCs at or before each row. rows: (m,) of them, ascending. before: (n,).
 * Returns: 0; -1 where they are not ascending rows. */
EXPORT int64_t syncline_before(int64_t n, int64_t m, const int64_t *rows, int64_t *before)
{
    int64_t i = 0, at;
    for (at = 0; at <= m; at++) {
        const int64_t stop = at < m ? rows[at] : n;
        if (stop < i || stop > n)
            return -1;
        for (; i < stop; i++)
            before[i] = at;
    }
    return 0;
}

/* A first value and all values up to each one, added up; both (n,). */
EXPORT int64_t syncline_running(int64_t n, int64_t first, const int64_t *values, int64_t *sums)
{
    /* Without a sign, as numpy wraps around. */
    uint64_t sum = (uint64_t)first;
    int64_t i;
    for (i = 0; i < n; i++) {
        sum += (uint64_t)values[i];
        sums[i] = (int64_t)sum;
    }
    return 0;
}

/* Least and largest value of each place: (p, 2). */
EXPORT int64_t syncline_limits(int64_t p, const int64_t *places, const int64_t *values,
                               int64_t *limits)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        const int64_t begin = places[2 * each], stop = places[2 * each + 1];
        int64_t low = values[begin], high = low;
        for (i = begin + 1; i < stop; i++) {
            low = values[i] < low ? values[i] : low;
            high = values[i] > high ? values[i] : high;
        }
        limits[2 * each] = low;
        limits[2 * each + 1] = high;
    }
    return 0;
}

/* What lies between each value of a place and the one before, and its limits: (p, 2).
 * first: (p,) the value before that of each place. differences: (k,), set within the places. */
EXPORT int64_t syncline_differences(int64_t p, const int64_t *places, const int64_t *values,
                                    const int64_t *first, int64_t *differences, int64_t *limits)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        const int64_t begin = places[2 * each], stop = places[2 * each + 1];
        const int64_t to_first = less(values[begin], first[each]);
        int64_t low = to_first, high = to_first;
        differences[begin] = to_first;
        for (i = begin + 1; i < stop; i++) {
            const int64_t step = less(values[i], values[i - 1]);
            differences[i] = step;
            low = step < low ? step : low;
            high = step > high ? step : high;
        }
        limits[2 * each] = low;
        limits[2 * each + 1] = high;
    }
    return 0;
}

/* How many frames of each place but its first bring the word of the one before: (p,). */
EXPORT int64_t syncline_repeated(int64_t p, const int64_t *places, const uint64_t *words,
                                 int64_t *counts)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        const int64_t begin = places[2 * each], stop = places[2 * each + 1];
        int64_t same = 0;
        for (i = begin + 1; i < stop; i++)
            same += words[i] == words[i - 1];
        counts[each] = same;
    }
    return 0;
}

/* How many values of each place belong to each kind: (p, kinds), added to.
 * values: (k,) positions in kind_of: (m,), each less than `kinds`. Returns: -1 where one is none. */
EXPORT int64_t syncline_kinds(int64_t p, const int64_t *places, const int64_t *values, int64_t m,
                              const uint8_t *kind_of, int64_t kinds, int64_t *counts)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        int64_t *own = counts + each * kinds;
        for (i = places[2 * each]; i < places[2 * each + 1]; i++) {
            if ((uint64_t)values[i] >= (uint64_t)m || kind_of[values[i]] >= kinds)
                return -1;
            own[kind_of[values[i]]]++;
        }
    }
    return 0;
}
