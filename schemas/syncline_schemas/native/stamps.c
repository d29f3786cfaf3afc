/* Times from one frame to the next: analyzer folds/bus/clock.py, folds/timing/bundles.py. */

#include "kernels.h"

/* A difference as numpy tells it, where it is too large. */
static inline uint64_t apart(const int64_t *t_ns, int64_t row)
{
    return (uint64_t)t_ns[row] - (uint64_t)t_ns[row - 1];
}

/* Rows that come later than `limit_ns` after the one before, ascending.
 * t_ns: (n,). rows: (n,), of which as many are set as are returned. */
EXPORT int64_t syncline_later(int64_t n, const int64_t *t_ns, int64_t limit_ns, int64_t *rows)
{
    int64_t row, found = 0;
    for (row = 1; row < n; row++) {
        rows[found] = row;
        found += (int64_t)apart(t_ns, row) > limit_ns;
    }
    return found;
}

/* How many of n rows come sooner than `limit_ns`, and not earlier, after the one before. */
EXPORT int64_t syncline_sooner(int64_t n, const int64_t *t_ns, int64_t limit_ns)
{
    int64_t row, found = 0;
    /* Without a sign, negative times are longer than any other. */
    for (row = 1; row < n; row++)
        found += apart(t_ns, row) < (uint64_t)limit_ns;
    return found;
}
