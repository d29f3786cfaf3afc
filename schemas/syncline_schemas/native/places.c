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

/* How many of m ascending rows are at or before a row, if not fewer than `at` are. */
static inline int64_t reached(int64_t m, const int64_t *rows, int64_t at, int64_t row)
{
    const int64_t near = m - at < 8 ? m : at + 8;
    int64_t step = 1;
    while (at < near && rows[at] <= row)
        at++;
    if (at < near)
        return at;
    for (; step <= m - at && rows[at + step - 1] <= row; step *= 2)
        at += step;
    for (; step > 0; step /= 2)
        if (step <= m - at && rows[at + step - 1] <= row)
            at += step;
    return at;
}

/* Position of the SYNC before each frame of the places, and the time since it.
 * rows, t_ns: (k,) of the frames. sync_rows: (m,) ascending. sync_ns: (m + 1,) by position, the
 * first one of the SYNC before all. last: (p,) the position before the first frame of each place.
 * position, since: (k,), set within the places. limits: (p, 4) least and longest time, least and
 * largest step from one position to the next. counts: (p, kinds), added to: how many positions,
 * numbered from `first_kind` (less than `kinds`) on, are of each kind modulo `kinds`. */
EXPORT int64_t syncline_after(int64_t p, const int64_t *places, const int64_t *rows,
                              const int64_t *t_ns, int64_t m, const int64_t *sync_rows,
                              const int64_t *sync_ns, const int64_t *last, int64_t first_kind,
                              int64_t kinds, int64_t *position, int64_t *since, int64_t *limits,
                              int64_t *counts)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        const int64_t begin = places[2 * each], stop = places[2 * each + 1];
        int64_t *own = counts + each * kinds, *found = limits + 4 * each;
        int64_t at = 0, before = last[each], least = INT64_MAX, most = INT64_MIN;
        int64_t low = INT64_MAX, high = INT64_MIN, kind = first_kind;
        for (i = begin; i < stop; i++) {
            const int64_t now = reached(m, sync_rows, at, rows[i]), step = less(now, before);
            kind += now - at;
            if (kind >= kinds)
                kind %= kinds;
            own[kind]++;
            position[i] = before = at = now;
            least = step < least ? step : least;
            most = step > most ? step : most;
        }
        for (i = begin; i < stop; i++) {
            const int64_t passed = less(t_ns[i], sync_ns[position[i]]);
            since[i] = passed;
            low = passed < low ? passed : low;
            high = passed > high ? passed : high;
        }
        found[0] = low;
        found[1] = high;
        found[2] = least;
        found[3] = most;
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

/* Frames of each place that bring the data of the one before.
 * rows: (k,) of the frames in `data`: (n, width) bytes, of which the first eight count.
 * runs: (p, 6) first and last data, how many frames repeat the one before, frames in the first run
 * of equal data, in the longest one between two changes, and in the last one, 0 if it is the first.
 * Returns: 0; -1 where a row is none. */
EXPORT int64_t syncline_runs(int64_t p, const int64_t *places, const int64_t *rows, int64_t n,
                             int64_t width, const uint8_t *data, int64_t *runs)
{
    int64_t each, i;
    for (each = 0; each < p; each++) {
        const int64_t begin = places[2 * each], stop = places[2 * each + 1];
        int64_t *found = runs + 6 * each;
        int64_t same = 0, head = 0, longest = 0, run_begin = begin;
        uint64_t before = 0;
        for (i = begin; i < stop; i++) {
            uint64_t word;
            if ((uint64_t)rows[i] >= (uint64_t)n)
                return -1;
            word = u64_at(data + rows[i] * width);
            if (i == begin) {
                found[0] = (int64_t)word;
            } else if (word == before) {
                same++;
            } else {
                const int64_t run = i - run_begin;
                if (run_begin == begin)
                    head = run;
                else
                    longest = run > longest ? run : longest;
                run_begin = i;
            }
            before = word;
        }
        found[1] = (int64_t)before;
        found[2] = same;
        found[3] = run_begin == begin ? stop - begin : head;
        found[4] = longest;
        found[5] = run_begin == begin ? 0 : stop - run_begin;
    }
    return 0;
}
