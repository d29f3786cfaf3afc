/* When frames can have been ready, by the arbitration of those before, and how long their devices
 * took: analyzer waiting.py, waiting_bus.py, device_times.py.
 *
 * Columns of the n frames of a bus: stamps, times on the wire (NaN where not known), places in the
 * arbitration (the lower wins), and senders. Answers, (r,), stand PDO by PDO, which begin where
 * edges, (p + 1,), tell; begins are the first p of these, and are changed. */

#include "kernels.h"

#include <math.h>

#define NO_NODE 0 /* a sender up to this is no node, or none that is known */
#define UNKNOWN (-1)
#define BROKEN (-2)

/* Of a row: the bus was idle before it; it shows what was ready; the stamps stepped back. */
enum { IDLE = 1, PROVES = 2, BACK = 4 };

/* A difference as numpy tells it, where it is too large. */
static inline int64_t less(int64_t one, int64_t other)
{
    return (int64_t)((uint64_t)one - (uint64_t)other);
}

/* As np.maximum and np.minimum: NaN where either is. */
static inline double more_of(double one, double other)
{
    return one > other || one != one ? one : other;
}

static inline double less_of(double one, double other)
{
    return one < other || one != one ? one : other;
}

static inline double least_0(double value)
{
    return value < 0.0 ? 0.0 : value;
}

static inline int finite(double value)
{
    return value - value == 0.0;
}

/* Answers of all PDOs are gone through so many rows at a time, whose columns stay at hand. */
#define AT_ONCE 8192

/* Whether any answers are left: those of rows that none can have. */
static inline int any_left(int64_t p, const int64_t *begins, const int64_t *edges)
{
    int64_t e;
    for (e = 0; e < p; e++)
        if (begins[e] < edges[e + 1])
            return 1;
    return 0;
}

static inline int64_t next_stop(int64_t stop, int64_t n)
{
    return stop < n - AT_ONCE ? stop + AT_ONCE : INT64_MAX;
}

typedef struct {
    double low, high;
} limits;

static inline limits with(limits before, double value)
{
    const limits now = {value < before.low ? value : before.low,
                        value > before.high ? value : before.high};
    return now;
}

/* Columns of the rows of a bus. before: the row before each that is of lower priority or comes
 * first after an idle bus; -1 without any. */
typedef struct {
    const uint32_t *rank;
    const int16_t *sender;
    const uint8_t *marks;
    const int32_t *before;
} bus_rows;

/* Marks of the rows of a bus, and `before` as above: (n,) each.
 * idle_ns: frames apart for longer than this, or closer by more, are not back to back.
 * Returns: how often the stamps stepped back. */
EXPORT int64_t syncline_arbitration(int64_t n, const int64_t *t_ns, const double *wire_ns,
                                    const uint32_t *rank, const int16_t *sender, double idle_ns,
                                    uint8_t *marks, int32_t *before)
{
    int64_t i, at, back = 0;
    double end_ns = 0.0;
    int after_frame = 0, sound = 0, waited = 0;
    for (i = 0; i <= n; i++) {
        double apart_ns = 0.0, spare_ns = 0.0;
        int closer = 0;
        if (i > 0 && i < n) {
            const double next_ns = (double)less(t_ns[i], t_ns[0]);
            apart_ns = next_ns - end_ns;
            spare_ns = apart_ns - wire_ns[i];
            closer = spare_ns < -idle_ns;
            end_ns = next_ns;
        }
        if (i > 0) {
            /* Where the next frame is too close, the stamp of this one may be too late. */
            if (sound && !closer && after_frame)
                marks[i - 1] |= (uint8_t)((waited ? IDLE : 0)
                                          | (sender[i - 1] != UNKNOWN ? PROVES : 0));
            after_frame = finite(wire_ns[i - 1]);
        }
        if (i == n)
            break;
        marks[i] = i > 0 && apart_ns < -idle_ns ? BACK : 0;
        back += marks[i] != 0;
        sound = i > 0 && finite(wire_ns[i]) && !closer;
        waited = spare_ns > idle_ns;
        for (at = i - 1; at >= 0 && !(marks[at] & IDLE) && rank[at] <= rank[i];)
            at = before[at];
        before[i] = (int32_t)at;
    }
    return back;
}

/* Distances of frames closer than most_ns behind others, less the time of the later one: (n,).
 * Returns: how many. */
EXPORT int64_t syncline_close(int64_t n, const int64_t *t_ns, const double *wire_ns, double most_ns,
                              double *close_ns)
{
    int64_t i, count = 0;
    for (i = 1; i < n; i++) {
        const double apart_ns = (double)less(t_ns[i], t_ns[i - 1]);
        close_ns[count] = apart_ns - wire_ns[i];
        count += close_ns[count] < most_ns && apart_ns >= 0 && finite(wire_ns[i - 1]);
    }
    return count;
}

/* Whether the last mark before each row has a stamp from since_ns on. rows, since_ns: (r,).
 * mark_rows, mark_ns: (m,), in order as the rows are. */
EXPORT int64_t syncline_marked(int64_t r, const int64_t *rows, const int64_t *since_ns, int64_t m,
                               const int64_t *mark_rows, const int64_t *mark_ns, uint8_t *found)
{
    int64_t i, at = 0;
    for (i = 0; i < r; i++) {
        while (at < m && mark_rows[at] < rows[i])
            at++;
        found[i] = (at ? mark_ns[at - 1] : INT64_MIN) >= since_ns[i];
    }
    return 0;
}

/* The row `before`, which leads nowhere but back. */
static inline int64_t step(const bus_rows *bus, int64_t at)
{
    const int64_t next = bus->before[at];
    return next >= -1 && next < at ? next : BROKEN;
}

/* Whether another node started this frame of lower priority behind one of another node. */
static inline int proof(const bus_rows *bus, int64_t at, uint32_t rank, int16_t sender)
{
    return (bus->marks[at] & PROVES) && at > 0 && bus->rank[at] > rank && bus->sender[at] != sender
           && bus->sender[at - 1] != sender;
}

/* See Arbitration.last_without. What lies up to row `stop` is not told apart. */
static int64_t last_without(const bus_rows *bus, int64_t row, uint32_t rank, int16_t sender,
                            int64_t itself, int64_t stop)
{
    int64_t at = row;
    if (!(bus->marks[row] & IDLE) && sender > NO_NODE) {
        if (itself && proof(bus, row, rank, sender))
            return row;
        for (at = row - 1; at > stop && !(bus->marks[at] & IDLE);) {
            if (bus->rank[at] <= rank)
                at = step(bus, at);
            else if (bus->sender[at] == sender)
                break;
            else if (proof(bus, at, rank, sender))
                return at;
            else
                at--;
        }
    }
    while (at > stop && !(bus->marks[at] & IDLE))
        at = step(bus, at);
    return at;
}

/* The last row up to each one of `rows` at whose start no frame of a PDO was ready: (r,).
 * ranks, senders: (r,). stops: (r,) rows before which none is looked for, or none.
 * Returns: 0; -1 where a row is none. */
EXPORT int64_t syncline_last_without(int64_t n, const uint32_t *rank, const int16_t *sender,
                                     const uint8_t *marks, const int32_t *before, int64_t r,
                                     const int64_t *rows, const uint32_t *ranks,
                                     const int16_t *senders, const int64_t *stops, int64_t itself,
                                     int64_t *found)
{
    const bus_rows bus = {rank, sender, marks, before};
    int64_t i;
    for (i = 0; i < r; i++) {
        const int64_t stop = stops ? stops[i] : -1;
        if ((uint64_t)rows[i] >= (uint64_t)n || stop < -1)
            return -1;
        found[i] = last_without(&bus, rows[i], ranks[i], senders[i], itself, stop);
        if (found[i] < -1)
            return -1;
        if (found[i] < stop)
            found[i] = stop;
    }
    return 0;
}

/* When answers can have been ready: what Ready holds, (r,), and the figures of Most, (p, 7).
 * steps: (n,) how often the stamps stepped back up to each row, or none where they never do.
 * ranks, senders: (p,). rows, position: (r,). sync_rows, sync_ns: (m,). low_ns, most_ns: (r,).
 * Returns: 0; -1 where a row or a position is none. */
EXPORT int64_t syncline_ready(
    int64_t n, const int64_t *t_ns, const double *wire_ns, const uint32_t *rank,
    const int16_t *sender, const uint8_t *marks, const int32_t *before, const int64_t *steps,
    double slack_ns, double join_ns, double intermission_ns, int64_t p, int64_t *begins,
    const int64_t *edges, const uint32_t *ranks, const int16_t *senders, const int64_t *rows,
    const int64_t *position, int64_t m, const int64_t *sync_rows, const int64_t *sync_ns,
    const double *low_ns, const double *most_ns, double *least_ns, double *waiting_ns,
    int64_t *first, uint8_t *free, uint8_t *known, double *figures)
{
    const bus_rows bus = {rank, sender, marks, before};
    const double no_figures[7] = {0.0, 0.0, 0.0, INFINITY, -INFINITY, INFINITY, -INFINITY};
    int64_t e, i, stop = 0;
    for (e = 0; e < p; e++)
        memcpy(figures + 7 * e, no_figures, sizeof no_figures);
    while (stop < INT64_MAX) {
        stop = next_stop(stop, n);
        for (e = 0; e < p; e++) {
            double *const figure = figures + 7 * e;
            double waited = figure[0], longest = figure[1], latest = figure[2];
            limits least_of = {figure[3], figure[4]}, waiting_of = {figure[5], figure[6]};
            for (i = begins[e]; i < edges[e + 1] && rows[i] < stop; i++) {
                const int64_t row = rows[i], at = position[i];
                int64_t last, sync_row;
                double end_ns, begun_ns, synced_ns, least, waiting, own;
                if ((uint64_t)row >= (uint64_t)n || (uint64_t)at >= (uint64_t)m)
                    return -1;
                sync_row = sync_rows[at];
                if (sync_row < -1 || sync_row >= n)
                    return -1;
                last = last_without(&bus, row, ranks[e], senders[e], 0, sync_row);
                if (last < -1)
                    return -1;
                synced_ns = (double)less(sync_ns[at], t_ns[0]);
                end_ns = (double)less(t_ns[row], t_ns[0]);
                begun_ns = end_ns - wire_ns[row] + intermission_ns;
                if (!finite(begun_ns))
                    begun_ns = end_ns;
                free[i] = (marks[row] & IDLE) != 0;
                if (last <= sync_row) {
                    least = synced_ns;
                    waiting = begun_ns - least + slack_ns;
                    first[i] = sync_row + 1;
                } else {
                    const double last_ns = (double)less(t_ns[last], t_ns[0]);
                    least = last_ns - wire_ns[last] + intermission_ns - slack_ns - join_ns;
                    waiting = begun_ns - least;
                    first[i] = last;
                }
                if (free[i])
                    waiting = 0.0;
                known[i] = !steps || steps[row] == (sync_row >= 0 ? steps[sync_row] : 0);
                least = least_0(least - synced_ns);
                least = less_of(more_of(least, low_ns[i]), most_ns[i]);
                waiting = less_of(least_0(waiting), least_0(most_ns[i] - least));
                own = wire_ns[row] - intermission_ns;
                least_ns[i] = least;
                waiting_ns[i] = waiting;
                longest = own > longest ? own : longest;
                if (!known[i])
                    continue;
                waited += (last <= sync_row ? sync_row + 1 : last) < row;
                latest = most_ns[i] > latest ? most_ns[i] : latest;
                least_of = with(least_of, least);
                waiting_of = with(waiting_of, waiting);
            }
            begins[e] = i;
            figure[0] = waited;
            figure[1] = longest;
            figure[2] = latest;
            figure[3] = least_of.low;
            figure[4] = least_of.high;
            figure[5] = waiting_of.low;
            figure[6] = waiting_of.high;
        }
    }
    return any_left(p, begins, edges) ? -1 : 0;
}

/* The next whole number up to, or from, a value; what is too large for an int64 is whole. */
static inline double whole(double value, int up)
{
    double down;
    if (!(value > -4503599627370496.0 && value < 4503599627370496.0))
        return value;
    down = (double)(int64_t)value;
    if (up)
        return down < value ? down + 1.0 : down;
    return down > value ? down - 1.0 : down;
}

/* Bounds of the times of devices, see DeviceTimes._bounds: (r,), and their limits: (p, 4).
 * sent, wire_bits: (n,). rows, position, response: (r,). sync_bits: (m,).
 * Returns: 0; -1 where a row or a position is none. */
EXPORT int64_t syncline_bounds(int64_t n, const int64_t *sent, const int64_t *wire_bits,
                               double bit_ns, double slack_ns, int64_t intermission, int64_t p,
                               int64_t *begins, const int64_t *edges, const int64_t *rows,
                               const int64_t *position, const int64_t *response, int64_t m,
                               const int64_t *sync_bits, double *low_ns, double *high_ns,
                               double *found)
{
    int64_t e, i, stop = 0;
    for (e = 0; e < 4 * p; e++)
        found[e] = e % 2 ? -INFINITY : INFINITY;
    while (stop < INT64_MAX) {
        stop = next_stop(stop, n);
        for (e = 0; e < p; e++) {
            double *const limit = found + 4 * e;
            limits low_of = {limit[0], limit[1]}, high_of = {limit[2], limit[3]};
            for (i = begins[e]; i < edges[e + 1] && rows[i] < stop; i++) {
                const int64_t row = rows[i], at = position[i];
                double busy_ns, own_ns, low, high;
                if ((uint64_t)row >= (uint64_t)n || (uint64_t)at >= (uint64_t)m)
                    return -1;
                busy_ns = (double)less(sent[row], sync_bits[at]) * bit_ns;
                own_ns = (double)less(wire_bits[row], intermission) * bit_ns;
                low = least_0(whole((double)response[i] - busy_ns, 0) - slack_ns);
                high = least_0(whole((double)response[i] - own_ns, 1) + slack_ns);
                low_ns[i] = low;
                high_ns[i] = high;
                low_of = with(low_of, low);
                high_of = with(high_of, high);
            }
            begins[e] = i;
            limit[0] = low_of.low;
            limit[1] = low_of.high;
            limit[2] = high_of.low;
            limit[3] = high_of.high;
        }
    }
    return any_left(p, begins, edges) ? -1 : 0;
}
