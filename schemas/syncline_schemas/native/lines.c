/* Frames out of lines of text whose layouts are known: analyzer readers/layout.py. */

#include "kernels.h"

#define MAX_LINE 512
#define WORD 8
#define NO_ROOM (-1)
#define TOO_WIDE (-2)

/* A layout, as numbers: these, then `tests` times (word, code, bits), then `decimals` times
 * (first, end) of digits that mean nothing, then `times` times (first, end, worth). */
enum {
    TESTS,
    DECIMALS,
    TIMES,
    BUS,
    FLAGS,
    DLC,
    ID_FIRST,
    ID_END,
    ID_IS_HEX,
    ID_LIMIT,
    ID_LEAST,
    ID_CONSTANT,
    DATA_FIRST,
    DATA_STEP,
    DATA_COUNT,
    T_CONSTANT,
    HEAD
};

#define EACH(byte) ((uint64_t)0x0101010101010101u * (byte))
#define EVEN_BYTES 0x00FF00FF00FF00FFu
#define EVEN_PAIRS 0x0000FFFF0000FFFFu

/* The last `digits` of eight characters, 0 to 8. */
static inline uint64_t last_of(int64_t digits)
{
    return digits <= 0 ? 0 : ~(uint64_t)0 << 8 * (WORD - digits);
}

/* Bit 7 of each byte whose character in `word` (with bits only where `wanted`) is no digit. */
static inline uint64_t not_decimal(uint64_t word, uint64_t wanted)
{
    const uint64_t value = (word ^ EACH(0x30)) & wanted;
    return ((value + EACH(0x76)) | value) & EACH(0x80);
}

static inline uint64_t not_hex(uint64_t word, uint64_t wanted)
{
    const uint64_t digit = (word ^ EACH(0x30)), letter = (word | EACH(0x20)) ^ EACH(0x60);
    const uint64_t low = EACH(0x7F);
    const uint64_t no_digit = (digit & low) + EACH(0x76);
    const uint64_t no_letter = ((letter & low) + EACH(0x79)) | ~((letter & low) + EACH(0x7F));
    return ((no_digit & no_letter) | word) & EACH(0x80) & wanted;
}

/* Of eight characters that end a word, those not wanted 0. */
static inline uint64_t decimal(uint64_t word, uint64_t wanted)
{
    uint64_t value = word & wanted & EACH(0x0F);
    value = (value * 10 + (value >> 8)) & EVEN_BYTES;
    value = (value * 100 + (value >> 16)) & EVEN_PAIRS;
    return (value * 10000 + (value >> 32)) & 0xFFFFFFFFu;
}

/* The low half: four bytes written as `11223344`, in that order. */
static inline uint64_t bytes_of(uint64_t word)
{
    const uint64_t nibbles = (word & EACH(0x0F)) + 9 * (word >> 6 & EACH(0x01));
    uint64_t value = (nibbles << 4 | nibbles >> 8) & EVEN_BYTES;
    value = (value | value >> 8) & EVEN_PAIRS;
    return (value | value >> 16) & 0xFFFFFFFFu;
}

static inline uint32_t swapped(uint32_t value)
{
    return value << 24 | (value << 8 & 0xFF0000u) | (value >> 8 & 0xFF00u) | value >> 24;
}

static inline int64_t hex_of(uint8_t character)
{
    return (character & 0x0F) + 9 * (character >> 6 & 1);
}

/* The columns of the lines of a block. */
struct columns {
    int64_t *t_ns;
    uint8_t *bus;
    uint32_t *can_id;
    uint16_t *flags;
    uint8_t *dlc;
    uint64_t *words;
    int64_t width;
    uint8_t *read, *timed;
};

/* Each of these returns 0 unless a character is none that its field may hold. Lines have eight
 * readable bytes before them, and as many behind their last whole word. */

static inline uint64_t other_text(const uint8_t *line, const int64_t *tests, int64_t count)
{
    uint64_t bad = 0;
    int64_t k;
    for (k = 0; k < count; k++, tests += 3)
        bad |= (u64_at(line + WORD * tests[0]) ^ (uint64_t)tests[1]) & (uint64_t)tests[2];
    return bad;
}

static inline uint64_t time_of(const uint8_t *line, const int64_t *layout, const int64_t *rest,
                               uint64_t *t_ns)
{
    uint64_t bad = 0, sum = (uint64_t)layout[T_CONSTANT];
    int64_t k;
    for (k = 0; k < layout[DECIMALS]; k++, rest += 2)
        bad |= not_decimal(u64_at(line + rest[1] - WORD), last_of(rest[1] - rest[0]));
    for (k = 0; k < layout[TIMES]; k++, rest += 3) {
        const uint64_t word = u64_at(line + rest[1] - WORD), wanted = last_of(rest[1] - rest[0]);
        bad |= not_decimal(word, wanted);
        sum += decimal(word, wanted) * (uint64_t)rest[2];
    }
    *t_ns = sum;
    return bad;
}

static inline uint64_t id_of(const uint8_t *line, const int64_t *layout, uint64_t *can_id)
{
    const uint64_t word = u64_at(line + layout[ID_END] - WORD);
    const uint64_t wanted = last_of(layout[ID_END] - layout[ID_FIRST]);
    const uint64_t written = layout[ID_IS_HEX] ? swapped((uint32_t)bytes_of(word & wanted))
                                               : decimal(word, wanted);
    *can_id = written + (uint64_t)layout[ID_CONSTANT];
    return (layout[ID_IS_HEX] ? not_hex(word, wanted) : not_decimal(word, wanted)) |
           (*can_id > (uint64_t)layout[ID_LIMIT]) | (*can_id < (uint64_t)layout[ID_LEAST]);
}

/* data: as many words as the frame needs, one at least. */
static inline uint64_t data_of(const uint8_t *line, const int64_t *layout, uint64_t *data)
{
    const int64_t count = layout[DATA_COUNT], step = layout[DATA_STEP];
    const uint8_t *first = line + layout[DATA_FIRST];
    uint64_t bad = 0;
    int64_t k;
    data[0] = 0;
    for (k = 1; 8 * k < count; k++)
        data[k] = 0;
    k = 0;
    if (count && step == 2) {
        for (; k + 4 <= count; k += 4) {
            const uint64_t word = u64_at(first + 2 * k);
            bad |= not_hex(word, ~(uint64_t)0);
            data[k / 8] |= bytes_of(word) << 8 * (k % 8);
        }
        if (k < count) {
            const uint64_t wanted = ((uint64_t)1 << 16 * (count - k)) - 1;
            const uint64_t word = u64_at(first + 2 * k);
            bad |= not_hex(word, wanted);
            data[k / 8] |= bytes_of(word & wanted) << 8 * (k % 8);
        }
        return bad;
    }
    for (; k < count; k++) {
        const uint8_t *pair = first + step * k;
        bad |= not_hex(u16_at(pair), 0xFFFF);
        data[k / 8] |= (uint64_t)(hex_of(pair[0]) << 4 | hex_of(pair[1])) << 8 * (k % 8);
    }
    return bad;
}

/* Whether a line has a layout; if so, its frame is put in row `row`, or TOO_WIDE. */
static int put(const struct columns *to, int64_t row, const uint8_t *line, const int64_t *layout)
{
    const int64_t *tests = layout + HEAD;
    uint64_t t_ns, can_id, data[8];
    int64_t k;
    if (other_text(line, tests, layout[TESTS]) ||
        (time_of(line, layout, tests + 3 * layout[TESTS], &t_ns) | id_of(line, layout, &can_id) |
         data_of(line, layout, data)))
        return 0;
    if (layout[DATA_COUNT] > 8 * to->width)
        return TOO_WIDE;
    if (layout[TIMES]) {
        to->t_ns[row] = (int64_t)t_ns;
        to->timed[row] = 1;
    }
    to->bus[row] = (uint8_t)layout[BUS];
    to->can_id[row] = (uint32_t)can_id;
    to->flags[row] = (uint16_t)layout[FLAGS];
    to->dlc[row] = (uint8_t)layout[DLC];
    to->read[row] = 1;
    to->words[to->width * row] = data[0];
    for (k = 1; 8 * k < layout[DATA_COUNT]; k++)
        to->words[to->width * row + k] = data[k];
    return 1;
}

/* Lines of a text; the last may lack its end. */
EXPORT int64_t syncline_count_lines(const uint8_t *text, int64_t size)
{
    int64_t ends = 0, at = 0;
    while (at < size) {
        const int64_t stop = size - at < 255 ? size : at + 255;
        uint8_t some = 0;
        for (; at < stop; at++)
            some = (uint8_t)(some + (text[at] == '\n'));
        ends += some;
    }
    return ends + (size > 0 && text[size - 1] != '\n');
}

/* Start and length of each line of a text, and the frames of those whose layout is known.
 * layouts: numbers as above, one layout behind the other; place: where each begins; of_length:
 * (514,) which ones are for lines of a length: [of_length[n], of_length[n + 1]), in the order in
 * which they are tried. hits: lines of each layout; of_this_length: (513,) lines of each length; both
 * are zeros. The columns have `capacity` zeros, `words`
 * `width` (1 or 8) numbers per line.
 * Returns: the number of lines; TOO_WIDE where one has more data than `width` words, NO_ROOM where
 * there are more than `capacity`. */
EXPORT int64_t syncline_lines(const uint8_t *text, int64_t size, const int64_t *layouts,
                              const int64_t *place, const int64_t *of_length, int64_t *hits,
                              int64_t *of_this_length, int64_t capacity, int64_t width, int64_t *starts, int64_t *lengths,
                              int64_t *t_ns, uint8_t *bus, uint32_t *can_id, uint16_t *flags,
                              uint8_t *dlc, uint64_t *words, uint8_t *read, uint8_t *timed)
{
    const struct columns to = {t_ns, bus, can_id, flags, dlc, words, width, read, timed};
    uint8_t copy[WORD + MAX_LINE + 2 * WORD];
    int64_t at = 0, row = 0;
    while (at < size) {
        const uint8_t *line = text + at;
        const uint8_t *end = memchr(line, '\n', (size_t)(size - at));
        const int64_t length = end ? end - line : size - at;
        int64_t k;
        if (row >= capacity)
            return NO_ROOM;
        starts[row] = at;
        lengths[row] = length;
        if (length <= MAX_LINE)
            of_this_length[length]++;
        if (length <= MAX_LINE && of_length[length] < of_length[length + 1]) {
            if (at < WORD || size - at - length < 2 * WORD) {
                memset(copy, 0, sizeof copy);
                memcpy(copy + WORD, line, (size_t)length);
                line = copy + WORD;
            }
            for (k = of_length[length]; k < of_length[length + 1]; k++) {
                const int found = put(&to, row, line, layouts + place[k]);
                if (found == TOO_WIDE)
                    return TOO_WIDE;
                if (found) {
                    hits[k]++;
                    break;
                }
            }
        }
        at += length + 1;
        row++;
    }
    return row;
}
