/* Counts of values in bins of equal width: analyzer distribution.py. */

#include "kernels.h"

/* Adds values to `counts`: (bins,). One of `ints` and `floats` holds them: (n,).
 * outside: (n,) rows of those that lie in none of the bins from `low` on.
 * Returns: how many these are. */
EXPORT int64_t syncline_histogram(int64_t n, const int64_t *ints, const double *floats, double low,
                                  double width, int64_t bins, int64_t *counts, int64_t *outside)
{
    const double end = (double)bins;
    int64_t i, left = 0;
    for (i = 0; i < n; i++) {
        const double above = (ints != 0 ? (double)ints[i] : floats[i]) - low;
        const double place = above / width;
        if (place >= 0.0 && place < end)
            counts[(int64_t)place]++;
        else
            outside[left++] = i;
    }
    return left;
}
