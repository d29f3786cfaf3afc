/* Counts of values in bins: analyzer distribution.py, folds/timing/load_shares.py. */

#include "kernels.h"

/* The coarse bin of a value: exponent and leading bits of the mantissa of value + 1. */
static int64_t coarse_key(double value, int64_t shift, int64_t first_key, int64_t bins)
{
    const double above = value + 1.0;
    int64_t bits, key;
    memcpy(&bits, &above, sizeof bits);
    key = bits < 0 ? 0 : (bits >> shift) - first_key;
    return key < 0 ? 0 : key < bins ? key : bins - 1;
}

/* Adds values to `fine`: (fine_bins,) bins of equal width from `low` on, those that lie in none of
 * them to `coarse`: (coarse_bins,) bins of floating point numbers from `first_key` on.
 * One of `ints` and `floats` holds them: (n,). above: (n,) by how much they exceed `low`.
 * Returns: 0. */
EXPORT int64_t syncline_histogram(int64_t n, const int64_t *ints, const double *floats, double low,
                                  double width, int64_t fine_bins, int64_t *fine, int64_t shift,
                                  int64_t first_key, int64_t coarse_bins, int64_t *coarse,
                                  double *above)
{
    const double end = (double)fine_bins;
    int64_t i;
    for (i = 0; i < n; i++) {
        const double value = ints != 0 ? (double)ints[i] : floats[i];
        const double more = value - low, place = more / width;
        above[i] = more;
        if (place >= 0.0 && place < end)
            fine[(int64_t)place]++;
        else
            coarse[coarse_key(value, shift, first_key, coarse_bins)]++;
    }
    return 0;
}

/* Adds to the count of each key how often it comes, and to its sum all that it weighs.
 * keys: (n,). One of `ints` and `floats` holds what they weigh: (n,). counts, sums: (bins,).
 * Returns: 0, or -1 where a key is none of the bins. */
EXPORT int64_t syncline_tally(int64_t n, const uint32_t *keys, const int64_t *ints,
                              const double *floats, int64_t bins, int64_t *counts, double *sums)
{
    int64_t i;
    for (i = 0; i < n; i++) {
        const uint32_t key = keys[i];
        if ((int64_t)key >= bins)
            return -1;
        counts[key]++;
        sums[key] += ints != 0 ? (double)ints[i] : floats[i];
    }
    return 0;
}
