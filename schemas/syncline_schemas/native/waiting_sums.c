/* What answers waited for, summed up by the frames ahead of them: analyzer delay_sums.py. */

#include "kernels.h"

#define AT_ONCE 4096

/* By PDO and key of the frames ahead: how many; of those, how many more than one of an answer; and
 * the `seq` of the answer that waited longest. */
typedef struct {
    int64_t frames, again, worst_seq;
} count_cell;

/* The same: their times, those of the answers that are being summed up, and the longest. */
typedef struct {
    double ns, part_ns, worst_ns;
} time_cell;

/* By group: what the frames of it took of the last answer that had one, and which one that was. */
typedef struct {
    double ns;
    int64_t answer;
} last_cell;

/* Whether an answer had a frame of a group already; `last` takes in this one. */
static inline int joins(last_cell *last, int64_t answer, double ns)
{
    const int joined = last->answer == answer;
    last->ns = joined ? last->ns + ns : ns;
    last->answer = answer;
    return joined;
}

/* Add up the times of the answers since the last call. */
static void settle(time_cell *times, int64_t cells)
{
    int64_t i;
    for (i = 0; i < cells; i++) {
        times[i].ns += times[i].part_ns;
        times[i].part_ns = 0.0;
    }
}

/* The answers that waited, (AT_ONCE,) by their rows from `row` on, and their PDOs; -1 for none.
 * begins: (p,) the next answer of each PDO. Returns: 0; -1 where the rows of a PDO do not ascend. */
static int64_t answers_from(int64_t row, int64_t p, int64_t *begins, const int64_t *edges,
                            const int64_t *rows, const int64_t *first, const uint8_t *known,
                            int32_t *answer_at, int32_t *pdo_at)
{
    int64_t e, i;
    memset(answer_at, -1, AT_ONCE * sizeof *answer_at);
    for (e = 0; e < p; e++) {
        for (i = begins[e]; i < edges[e + 1] && rows[i] < row + AT_ONCE; i++) {
            if (rows[i] < row)
                return -1;
            if (!known[i] || first[i] < 0 || first[i] >= rows[i])
                continue;
            answer_at[rows[i] - row] = (int32_t)i;
            pdo_at[rows[i] - row] = (int32_t)e;
        }
        begins[e] = i;
    }
    return 0;
}

/* Sums of the answers that waited, in order of arrival.
 * place, wire_ns, sender, seq: (n,) of the frames; the place of an error is k. group_of: (k,),
 * less than s. edges: (p + 1,), begins: the first p of them, which are changed. rows, first, known:
 * (r,) of the answers; part: times of so many are summed up at a time. counts, times: (p, k).
 * again, worst_ns, worst_seq: (p, s) of the answers with several frames of a group. To work with:
 * last_of (65536,), all -1; last_key (k,) and last_group (s,) of no answer.
 * Returns: how many answers waited; -1 where a group or a row is none, or the rows of a PDO do not
 * ascend. */
EXPORT int64_t syncline_delays(int64_t n, const int64_t *place, const double *wire_ns,
                               const int16_t *sender, const int64_t *seq, int64_t k,
                               const int64_t *group_of, int64_t s, int64_t p, int64_t *begins,
                               const int64_t *edges, const int64_t *rows, const int64_t *first,
                               const uint8_t *known, int64_t part, count_cell *counts,
                               time_cell *times, int64_t *again, double *worst_ns,
                               int64_t *worst_seq, int32_t *last_of, last_cell *last_key,
                               last_cell *last_group)
{
    int32_t answer_at[AT_ONCE], pdo_at[AT_ONCE];
    int64_t e, i, row, at, waited = 0, pair = -1;
    for (i = 0; i < k; i++)
        if ((uint64_t)group_of[i] >= (uint64_t)s)
            return -1;
    for (row = 0; row < n; row++) {
        int32_t *const before = last_of + (uint16_t)sender[row];
        const int64_t here = row % AT_ONCE;
        if (here == 0
            && answers_from(row, p, begins, edges, rows, first, known, answer_at, pdo_at) < 0)
            return -1;
        if (answer_at[here] >= 0) {
            const int64_t pdo = pdo_at[here], answer = answer_at[here];
            /* Whether any sender has two of the frames ahead. */
            const int joined = pair >= first[answer];
            for (at = first[answer]; at < row; at++) {
                const int64_t key = place[at];
                const double took = wire_ns[at] == wire_ns[at] ? wire_ns[at] : 0.0;
                count_cell *count;
                time_cell *time;
                double most = took;
                if ((uint64_t)key >= (uint64_t)k)
                    continue;
                count = counts + pdo * k + key;
                time = times + pdo * k + key;
                count->frames++;
                time->part_ns += took;
                if (joined) {
                    last_cell *const group = last_group + group_of[key];
                    const int64_t cell = pdo * s + group_of[key];
                    if (joins(last_key + key, answer, took)) {
                        count->again++;
                        most = last_key[key].ns;
                    }
                    if (joins(group, answer, took)) {
                        again[cell]++;
                        if (group->ns > worst_ns[cell]) {
                            worst_ns[cell] = group->ns;
                            worst_seq[cell] = seq[row];
                        }
                    }
                }
                if (most > time->worst_ns) {
                    time->worst_ns = most;
                    count->worst_seq = seq[row];
                }
            }
            if (++waited % part == 0)
                settle(times, p * k);
        }
        pair = *before > pair ? *before : pair;
        *before = (int32_t)row;
    }
    settle(times, p * k);
    for (e = 0; e < p; e++)
        if (begins[e] < edges[e + 1])
            return -1;
    return waited;
}
