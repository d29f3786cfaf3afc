/* Smallest and largest values of runs: analyzer series.py. */

#include <math.h>

#include "kernels.h"

/* A key out of eight bytes that hold a whole number or another. */
static inline double key_at(const uint64_t *keys, int64_t row, int64_t whole)
{
    int64_t number;
    double other;
    memcpy(&number, keys + row, sizeof number);
    memcpy(&other, keys + row, sizeof other);
    return whole ? (double)number : other;
}

static inline int64_t extremes(int64_t n, const uint64_t *keys, int64_t whole, int64_t run,
                               int64_t *rows)
{
    int64_t begin, found = 0;
    for (begin = 0; begin < n; begin += run) {
        const int64_t stop = n - begin < run ? n : begin + run;
        double low = key_at(keys, begin, whole), high = low;
        int64_t least = begin, most = begin, i;
        if (low != low) {
            low = INFINITY;
            high = -INFINITY;
        }
        for (i = begin + 1; i < stop; i++) {
            const double value = key_at(keys, i, whole);
            if (value < low) {
                low = value;
                least = i;
            }
            if (value > high) {
                high = value;
                most = i;
            }
        }
        rows[found++] = least < most ? least : most;
        if (least != most)
            rows[found++] = least < most ? most : least;
    }
    return found;
}

/* Rows of the smallest and of the largest value of each `run` values, ascending; the first of equal
 * ones, once where they are the same. The last run may be shorter. NaN never is one of them where
 * there is a number.
 * rows: (2 * ceil(n / run),). Returns: how many rows there are. */
EXPORT int64_t syncline_extremes(int64_t n, const uint64_t *values, int64_t run, int64_t *rows)
{
    return extremes(n, values, 0, run, rows);
}

/* Columns of several blocks that are one behind the other.
 * lengths: (b,). sources: (c, b) where each column of each block begins; eight bytes a value. */
typedef struct {
    int64_t blocks, columns;
    const int64_t *lengths;
    const uint64_t *const *sources;
} Blocks;

typedef struct {
    int64_t block, row;
} Place;

/* Each column at some rows of a block, counted from `from` on. */
static void gather(const Blocks *all, Place from, int64_t n, const int64_t *rows,
                   uint64_t *const *kept, int64_t at)
{
    int64_t column, i;
    for (column = 0; column < all->columns; column++) {
        const uint64_t *source = all->sources[column * all->blocks + from.block] + from.row;
        uint64_t *to = kept[column] + at;
        for (i = 0; i < n; i++)
            to[i] = source[rows[i]];
    }
}

/* As `extremes` and `gather`, of one run of n rows that begins in one block and ends in another. */
static int64_t across(const Blocks *all, int64_t n, const uint64_t *const *keys, int64_t whole,
                      Place *from, uint64_t *const *kept, int64_t at)
{
    static const int64_t here[1] = {0};
    Place place = *from, least = place, most = place;
    int64_t i, first = 0, last = 0;
    double low = key_at(keys[place.block], place.row, whole), high = low;
    if (low != low) {
        low = INFINITY;
        high = -INFINITY;
    }
    for (i = 0; i < n; i++, place.row++) {
        double value;
        for (; place.row == all->lengths[place.block]; place.row = 0)
            place.block++;
        value = key_at(keys[place.block], place.row, whole);
        if (value < low) {
            low = value;
            least = place;
            first = i;
        }
        if (value > high) {
            high = value;
            most = place;
            last = i;
        }
    }
    *from = place;
    gather(all, first < last ? least : most, 1, here, kept, at);
    if (first == last)
        return 1;
    gather(all, first < last ? most : least, 1, here, kept, at + 1);
    return 2;
}

#define RUNS_AT_ONCE 256

static inline int64_t thinned(const Blocks *all, int64_t n, int64_t run, int64_t key, int64_t whole,
                              uint64_t *const *kept)
{
    const uint64_t *const *keys = all->sources + key * all->blocks;
    Place at = {0, 0};
    int64_t rows[2 * RUNS_AT_ONCE], found = 0;
    while (n > 0) {
        int64_t runs, done;
        for (; at.row == all->lengths[at.block]; at.row = 0)
            at.block++;
        runs = (n < all->lengths[at.block] - at.row ? n : all->lengths[at.block] - at.row) / run;
        runs = runs < RUNS_AT_ONCE ? runs : RUNS_AT_ONCE;
        if (runs > 0) {
            const int64_t more = extremes(runs * run, keys[at.block] + at.row, whole, run, rows);
            gather(all, at, more, rows, kept, found);
            found += more;
            at.row += done = runs * run;
        } else {
            done = n < run ? n : run;
            found += across(all, done, keys, whole, &at, kept, found);
        }
        n -= done;
    }
    return found;
}

/* Of the first n rows of blocks those that `syncline_extremes` finds, of all columns.
 * key: the column of the values, which are `whole` numbers or others. lengths: of n rows or more.
 * kept: (c,) where columns of 2 * ceil(n / run) begin. Returns: how many rows there are. */
EXPORT int64_t syncline_thinned(int64_t n, int64_t run, int64_t blocks, const int64_t *lengths,
                                int64_t columns, int64_t key, int64_t whole,
                                const uint64_t *const *sources, uint64_t *const *kept)
{
    Blocks all;
    all.blocks = blocks;
    all.columns = columns;
    all.lengths = lengths;
    all.sources = sources;
    return whole ? thinned(&all, n, run, key, 1, kept) : thinned(&all, n, run, key, 0, kept);
}
