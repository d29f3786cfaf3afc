/* How long a bus was busy, and its fullest moment: analyzer folds/timing/load_busy.py. */

#include "kernels.h"

#define AT_ONCE 256

static int64_t apart(int64_t later, int64_t earlier)
{
    return (int64_t)((uint64_t)later - (uint64_t)earlier);
}

/* To the nearest integer, halves to the even one; for less than 2^51. */
static int64_t nearest(double value)
{
    const double whole = 6755399441055744.0; /* 1.5 * 2^52: no room for a fraction above it */
    return (int64_t)((value + whole) - whole);
}

/* Frames back to back: a stretch begins with one that comes after a pause, or impossibly soon.
 * t_ns, wire_ns: (n,) end of each frame, and how long it was on the wire. before_ns: end of the
 * frame before; where there is none, `known` is 0, and a stretch begins.
 * soon: (n,) set to whether less than `least_ns` lies between a frame and that before; more than
 * `most_ns` is a pause.
 * rows: (4,) where the first and the last stretch begin, n where none does; first and last frame
 * of the longest. Returns: how many come too soon. */
EXPORT int64_t syncline_stretches(int64_t n, const int64_t *t_ns, const double *wire_ns,
                                  int64_t known, int64_t before_ns, double least_ns,
                                  double most_ns, uint8_t *soon, int64_t *rows)
{
    int64_t begin, i, early = 0, first = n, last = n, longest = n, end = n, begun_ns = 0, most = 0;
    for (begin = 0; begin < n; begin += AT_ONCE) {
        const int64_t stop = n - begin < AT_ONCE ? n : begin + AT_ONCE;
        int64_t begins[AT_ONCE], count = 0;
        /* Where stretches begin, without a branch that nobody could foresee. */
        for (i = begin; i < stop; i++) {
            const double idle_ns = (double)apart(t_ns[i], before_ns) - wire_ns[i];
            const int too_soon = idle_ns < least_ns && known;
            soon[i] = (uint8_t)too_soon;
            early += too_soon;
            begins[count] = i;
            count += too_soon | (idle_ns > most_ns) | !known;
            known = 1;
            before_ns = t_ns[i];
        }
        for (i = 0; i < count; i++) {
            const int64_t row = begins[i];
            if (first == n) {
                first = row;
            } else if (longest == n || apart(t_ns[row - 1], begun_ns) > most) {
                most = apart(t_ns[row - 1], begun_ns);
                longest = last;
                end = row - 1;
            }
            last = row;
            begun_ns = apart(t_ns[row], nearest(wire_ns[row]));
        }
    }
    if (last < n && (longest == n || apart(t_ns[n - 1], begun_ns) > most)) {
        longest = last;
        end = n - 1;
    }
    rows[0] = first;
    rows[1] = last;
    rows[2] = longest;
    rows[3] = end;
    return early;
}

/* Frames of a bus, and windows of a width of which the fullest is looked for. */
typedef struct {
    int64_t n, known;
    const int64_t *t_ns;
    const double *wire_ns;
    int64_t begun_ns;
    double width_ns, longest_ns;
    int64_t spoiled;
    const double *after, *until;
    double *busy;
    int64_t *rows, *before;
    double *ends;
    uint8_t *knot; /* whether busy time is told around this row */
} Bus;

static double since(const Bus *bus, int64_t row)
{
    return (double)apart(bus->t_ns[row], bus->begun_ns);
}

static int is_spoiled(const Bus *bus, double end)
{
    int64_t low = 0, high = bus->spoiled;
    while (low < high) {
        const int64_t middle = low + (high - low) / 2;
        if (bus->after[middle] < end)
            low = middle + 1;
        else
            high = middle;
    }
    return low > 0 && end <= bus->until[low - 1];
}

/* The first row that ends at a moment or later, n where none does; `near` is a row near it. */
static int64_t first_from(const Bus *bus, double moment, int64_t near)
{
    int64_t low, high, step = 1;
    near = near < bus->n ? near : bus->n - 1;
    if (since(bus, near) < moment) {
        for (low = near, high = near + 1; high < bus->n && since(bus, high) < moment; step *= 2) {
            low = high;
            high += 2 * step;
        }
        high = high < bus->n ? high : bus->n;
    } else {
        for (high = near, low = near - 1; low >= 0 && since(bus, low) >= moment; step *= 2) {
            high = low;
            low -= 2 * step;
        }
        low = low > -1 ? low : -1;
    }
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        if (since(bus, middle) < moment)
            low = middle;
        else
            high = middle;
    }
    return high;
}

/* Marks the rows around a moment; returns `first_from`. */
static int64_t mark_knots(const Bus *bus, double moment, int64_t near)
{
    const int64_t first = first_from(bus, moment, near);
    int64_t row;
    for (row = first > 0 ? first - 1 : 0; row <= first + 1 && row < bus->n; row++)
        bus->knot[row] = 1;
    return first;
}

/* How long the bus was busy until a moment whose knots are marked: on lines between where a frame
 * begins, no sooner than that before ends, and where it ends. `next`: its `first_from`. */
static double busy_until(const Bus *bus, double moment, int64_t next)
{
    int64_t row = next - 1;
    double ended, starts, level;
    /* The last knot that ends at this very moment. */
    for (; next < bus->n && since(bus, next) == moment; next++)
        row = bus->knot[next] ? next : row;
    if (next == bus->n || !bus->knot[next])
        return row >= 0 ? bus->busy[row] : 0.0;
    ended = row >= 0 ? since(bus, row) : 0.0;
    starts = since(bus, next) - bus->wire_ns[next];
    if (row >= 0 && starts < ended)
        starts = ended;
    level = bus->busy[next] - bus->wire_ns[next];
    if (moment > starts)
        return (bus->busy[next] - level) / (since(bus, next) - starts) * (moment - starts) + level;
    if (moment == starts || row < 0)
        return level;
    if (moment == ended)
        return bus->busy[row];
    return (level - bus->busy[row]) / (starts - ended) * (moment - ended) + bus->busy[row];
}

/* Windows that end with a frame, of which all frames that end in them carry almost `least_ns`: their
 * rows, and the last ones before them. They carry no less than these without the first.
 * sure_ns: what the fullest carries. Returns: how many there are. */
static int64_t full_windows(const Bus *bus, double least_ns, double *sure_ns)
{
    double sum = 0.0, sum_before = 0.0, sure = 0.0;
    int64_t row, kept = 0, outside = 0;
    for (row = 0; row < bus->n; row++) {
        double end;
        sum = row > 0 ? sum + bus->wire_ns[row] : bus->wire_ns[row];
        bus->busy[row] = sum;
        /* Mostly too little even with frames that end before the window. */
        if (sum - sum_before < least_ns - bus->longest_ns)
            continue;
        end = since(bus, row);
        while (outside < row && since(bus, outside) <= end - bus->width_ns)
            sum_before = bus->busy[outside++];
        if (sum - sum_before < least_ns - bus->longest_ns)
            continue;
        bus->rows[kept] = row;
        bus->before[kept++] = outside - 1;
        if (sum - sum_before > sure && row >= bus->known && end >= bus->width_ns
            && !is_spoiled(bus, end))
            sure = sum - sum_before;
    }
    *sure_ns = sure - bus->longest_ns;
    return kept;
}

/* Ends of the windows that may carry `least_ns`, of `count` ones that end with a frame and of those
 * that begin with one: these carry no more than one frame beyond the former.
 * Returns: how many there are. */
static int64_t ends_of(const Bus *bus, int64_t count, double least_ns)
{
    int64_t i, row, kept = 0, found = 0, start = 0;
    for (i = 0; i < count; i++) {
        double most;
        row = bus->rows[i];
        most = bus->busy[row] - (bus->before[i] >= 0 ? bus->busy[bus->before[i]] : 0.0);
        if (most < least_ns - bus->longest_ns)
            continue;
        bus->rows[kept] = row;
        bus->before[kept++] = bus->before[i];
        if (row >= bus->known)
            bus->ends[found++] = since(bus, row);
    }
    for (i = 0; i < kept; i++) {
        double last_start;
        row = bus->rows[i] + 1 < bus->n ? bus->rows[i] + 1 : bus->rows[i];
        last_start = since(bus, row) - bus->width_ns + bus->longest_ns;
        start = start > bus->before[i] ? start : bus->before[i];
        for (; start < bus->n && since(bus, start) <= last_start; start++)
            bus->ends[found++] = since(bus, start) - bus->wire_ns[start] + bus->width_ns;
    }
    return found;
}

/* The window of a width that carries most, of those that end or begin with a frame.
 * t_ns, wire_ns: (n,) as above, ascending; n is not 0. known: windows up to this row need not be
 * looked at. Moments count from `begun_ns`. longest_ns: of `wire_ns`. least_ns: windows that carry
 * less need not be looked at. after, until: (spoiled,) windows that end after one of these moments,
 * until the other, do not count.
 * busy: (n,), rows, before, ends: (2 n,), knot: (n,) of zeros: made use of.
 * found: (2,) what the window carries, and its end. Returns: whether there is one. */
EXPORT int64_t syncline_fullest_window(int64_t n, int64_t known, const int64_t *t_ns,
                                       const double *wire_ns, int64_t begun_ns, double width_ns,
                                       double longest_ns, double least_ns, int64_t spoiled,
                                       const double *after, const double *until, double *busy,
                                       int64_t *rows, int64_t *before, double *ends, uint8_t *knot,
                                       double *found)
{
    const Bus bus = {n,       known, t_ns,  wire_ns, begun_ns, width_ns, longest_ns, spoiled,
                     after,   until, busy,  rows,    before,   ends,     knot};
    double sure_ns;
    const int64_t full = full_windows(&bus, least_ns, &sure_ns);
    const int64_t windows = ends_of(&bus, full, sure_ns > least_ns ? sure_ns : least_ns);
    int64_t i, kept = 0, end_row = 0, start_row = 0;
    for (i = 0; i < windows; i++) {
        const double end = ends[i];
        if (end < width_ns || end > since(&bus, n - 1) || is_spoiled(&bus, end))
            continue;
        end_row = mark_knots(&bus, end, end_row);
        start_row = mark_knots(&bus, end - width_ns, start_row);
        rows[kept] = end_row;
        before[kept] = start_row;
        ends[kept++] = end;
    }
    for (i = 0; i < kept; i++) {
        const double carried =
            busy_until(&bus, ends[i], rows[i]) - busy_until(&bus, ends[i] - width_ns, before[i]);
        if (i == 0 || carried > found[0]) {
            found[0] = carried;
            found[1] = ends[i];
        }
    }
    return kept > 0;
}
