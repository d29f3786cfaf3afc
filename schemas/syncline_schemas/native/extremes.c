/* Smallest and largest values of runs: analyzer series.py. */

#include <math.h>

#include "kernels.h"

/* Rows of the smallest and of the largest value of each `run` values, ascending; the first of equal
 * ones, once where they are the same. The last run may be shorter. NaN never is one of them where
 * there is a number.
 * rows: (2 * ceil(n / run),). Returns: how many rows there are. */
EXPORT int64_t syncline_extremes(int64_t n, const double *values, int64_t run, int64_t *rows)
{
    int64_t begin, found = 0;
    for (begin = 0; begin < n; begin += run) {
        const int64_t stop = n - begin < run ? n : begin + run;
        double low = values[begin], high = values[begin];
        int64_t least = begin, most = begin, i;
        if (low != low) {
            low = INFINITY;
            high = -INFINITY;
        }
        for (i = begin + 1; i < stop; i++) {
            if (values[i] < low) {
                low = values[i];
                least = i;
            }
            if (values[i] > high) {
                high = values[i];
                most = i;
            }
        }
        rows[found++] = least < most ? least : most;
        if (least != most)
            rows[found++] = least < most ? most : least;
    }
    return found;
}
