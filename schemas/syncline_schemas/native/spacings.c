/* Spacings of several frames in a row: analyzer folds/timing/bit_rate.py. */

#include "kernels.h"

/* Those that are at most `within_ns` longer than their bits of `bit_ns` each.
 * apart_ns, bits: (n,) of single frames; one that counts for nothing is negative, and so do all in
 * which it lies. frames: 1 to n. close_ns, close_bits: (n,), of which as many are set as are
 * returned. lengths: (limit,) how many have so many bits; zeros, filled here. Returns -1 where
 * some have more. */
EXPORT int64_t syncline_close_runs(
    int64_t n, const int64_t *apart_ns, const int64_t *bits, int64_t frames, double bit_ns,
    double within_ns, int64_t *close_ns, int64_t *close_bits, int64_t limit, int64_t *lengths)
{
    int64_t row, found = 0, since = 0;
    /* Sums as numpy tells them, where they are too large. */
    uint64_t time_ns = 0, length = 0;
    for (row = 0; row < n; row++) {
        if (apart_ns[row] < 0) {
            since = row + 1;
            time_ns = length = 0;
            continue;
        }
        time_ns += (uint64_t)apart_ns[row];
        length += (uint64_t)bits[row];
        if (row - since + 1 > frames) {
            time_ns -= (uint64_t)apart_ns[row - frames];
            length -= (uint64_t)bits[row - frames];
        }
        if (row - since + 1 < frames)
            continue;
        if (length >= (uint64_t)limit)
            return -1;
        lengths[length]++;
        close_ns[found] = (int64_t)time_ns;
        close_bits[found] = (int64_t)length;
        found += (double)(int64_t)time_ns - (double)length * bit_ns <= within_ns;
    }
    return found;
}
