#include "measure.h"

#include "addition.h"
#include "huecount.h"
#include "load.h"

#ifndef HPCOMP_LEVEL
#error "compile with -DHPCOMP_LEVEL=<name of this instruction set's measuring>"
#endif

namespace hpcomp {
namespace {

// Beyond this a colour is left out: its square still is a float.
constexpr float kLargestMeasured = 0x1p60f;

// Masks are planes of 0 and 1, which multiply and add like any other.
HPCOMP_INLINE float as_mask(bool holds) { return holds ? 1.0f : 0.0f; }

HPCOMP_INLINE int64_t count_of(const float *mask, int n) {
    int count = 0;
    for (int i = 0; i < n; ++i) count += mask[i] != 0;
    return count;
}

HPCOMP_INLINE float part_of(float numerator, float denominator) {
    const float quotient = denominator > 0 ? numerator / denominator : 0.0f;
    return clamped(quotient);
}

HPCOMP_INLINE float length(float x, float y) { return __builtin_sqrtf(x * x + y * y); }

// --- a block -------------------------------------------------------------------------------------

// A block's terms: of the layers that are there, bottom first, and then of the background. The loops copy what
// they need of it, and take rows that do not overlap: else every pixel that is written could be a rule.
struct Block {
    const Rules &rules;
    const MeasureRules &measures;
    const Layer *stack;     // who is behind whom
    int n;                  // pixels
    int layers;             // the place of the background, too
    const int *numbers;     // (layers + 1): of the terms among all layers; after these the background's
    const int *places;      // of such a number among what is measured
    float *p, *size;        // (layers + 1, 2, kBlock) and (layers + 1, kBlock): terms and |t|
    float *near;            // (layers + 1, kBlock): whose hue is the result's
    int *active, actives;   // the terms that are anything here
    bool small;             // whether no sum of sizes is more than `kSmallAddend`
    const float *luminance, *total, *alpha;
    Cell *cells;            // (places, cell_columns): from that of the first pixel on
    int cell_columns, cell_left;  // how far inside of its cell that pixel is

    const float *x(int k) const { return p + int64_t(k) * 2 * kBlock; }
    const float *y(int k) const { return x(k) + kBlock; }
};

// Whether the hues of two vectors are no farther apart than the tolerance; true where one has none.
HPCOMP_INLINE bool holds(const MeasureRules &measures, float x1, float y1, float x2, float y2) {
    const float dot = x1 * x2 + y1 * y2, cross = magnitude(x1 * y2 - y1 * x2);
    return cross * measures.cosine <= dot * measures.sine;  // sin(angle - tolerance) <= 0
}

// How the terms stand to a result: its |p|, the sum of the sizes of the terms of its hue, and
// whether that hue is somebody's. Fills `near`.
struct Support {
    Plane size, backing, has_hue;
};

void support_of(const Block &block, ConstRow p0, ConstRow p1, Support *found) {
    const MeasureRules measures = block.measures;
    const int n = block.n;
    Row length_of = found->size, backing = found->backing, has_hue = found->has_hue;
    for (int i = 0; i < n; ++i) {
        length_of[i] = length(p0[i], p1[i]);
        backing[i] = 0;
    }
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        ConstRow x = block.x(k), y = block.y(k), size = block.size + k * kBlock;
        Row near = block.near + k * kBlock;
        for (int i = 0; i < n; ++i) {
            near[i] = as_mask(holds(measures, p0[i], p1[i], x[i], y[i]));
            backing[i] += near[i] * size[i];
        }
    }
    for (int i = 0; i < n; ++i)
        has_hue[i] = as_mask((length_of[i] > measures.half_step) & (backing[i] > measures.half_step));
}

// The number plus 1 of the layer whose hue survived, 0 for none, and its |t|; the lower of two.
void winners(const Block &block, const Support &support, Row winner, Row size) {
    const float half_step = block.measures.half_step;
    const int n = block.n;
    Plane theirs;
    for (int i = 0; i < n; ++i) winner[i] = size[i] = theirs[i] = 0;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        if (k == block.layers) continue;
        const float number = float(block.numbers[k] + 1);
        ConstRow near = block.near + k * kBlock, of = block.size + k * kBlock;
        for (int i = 0; i < n; ++i) {
            const float own = near[i] * of[i];
            theirs[i] += own;
            winner[i] = own > size[i] ? number : winner[i];
            size[i] = larger(own, size[i]);
        }
    }
    for (int i = 0; i < n; ++i) {
        const bool there = (support.has_hue[i] != 0) & (theirs[i] > half_step);
        winner[i] = there ? winner[i] : 0.0f;
    }
}

// Pixels of a block that are so, as bytes of 0 and 1 in whole cells.
struct CellMask {
    uint8_t bytes[kBlock + 2 * kCell] = {};
};

// Calls `take(cell, pixels)` for each cell in which the mask of a block holds; returns for how many pixels.
template <class Take> HPCOMP_INLINE int count_in_cells(const Block &block, const CellMask &mask, Take take) {
    constexpr uint64_t kOnes = 0x0101010101010101u;
    int all = 0;
    for (int begin = 0, cell = 0; begin < block.cell_left + block.n; begin += kCell, ++cell) {
        uint64_t halves[2];
        static_assert(sizeof halves == kCell);
        std::memcpy(halves, mask.bytes + begin, kCell);
        const int pixels = int(((halves[0] + halves[1]) * kOnes) >> 56);
        if (pixels == 0) continue;
        take(cell, pixels);
        all += pixels;
    }
    return all;
}

// The sums of a picture's squares that some pixels of a row are added to.
struct SquareRow {
    int64_t *sums;  // of the squares of that row; null where they are not wanted
    int scale, column;

    // Of picture `number` in row `y` of the strip, from `column` on.
    static SquareRow of(const Squares &squares, int number, int column, int y) {
        if (squares.first == nullptr) return {};
        const int64_t row = int64_t(number) * squares.rows + (squares.top + y) / squares.scale;
        return {squares.first + row * squares.columns * 4, squares.scale, column};
    }
};

// Adds one channel; what is no number counts as nothing.
template <class Unit, class UnitsOf>
HPCOMP_INLINE void add_channel(const SquareRow &to, int channel, int n, ConstRow values, UnitsOf units_of_value) {
    Unit units[kBlock];
    for (int i = 0; i < n; ++i) units[i] = units_of_value(values[i]);
    int64_t *sums = to.sums + int64_t(to.column / to.scale) * 4 + channel;
    for (int begin = 0, end = to.scale - to.column % to.scale; begin < n; begin = end, end += to.scale, sums += 4) {
        int64_t sum = 0;
        for (int i = begin; i < (end < n ? end : n); ++i) sum += units[i];
        *sums += sum;
    }
}

// Adds `n` pixels, planes of their colours and alpha; `small`: none is larger than `kSmallAddend`.
void add_squares(const SquareRow &to, int n, const float *const (&planes)[4], bool small) {
    if (to.sums == nullptr) return;
    for (int channel = 0; channel < 4; ++channel) {
        if (small)
            add_channel<int32_t>(to, channel, n, planes[channel], [](float v) { return small_units_of(v); });
        else
            add_channel<int64_t>(to, channel, n, planes[channel],
                                 [](float v) { return units_of(within_addends(v == v ? v : 0.0f)); });
    }
}

// Adds what the terms are, whatever becomes of them.
void add_terms(const Block &block, ContributorSums *sums) {
    const float half_step = block.measures.half_step;
    const int n = block.n;
    CellMask contributes;
    uint8_t *const mask = contributes.bytes + block.cell_left;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        ConstRow size = block.size + k * kBlock;
        for (int i = 0; i < n; ++i) mask[i] = size[i] > half_step;
        const int place = block.places[block.numbers[k]];
        Cell *const cells = block.cells + int64_t(place) * block.cell_columns;
        sums[place].pixels += count_in_cells(block, contributes, [=](int cell, int pixels) {
            cells[cell].pixels = uint16_t(cells[cell].pixels + pixels);
        });
        sums[place].chroma += sum_of(size, n, block.small);
    }
}

// Measures result `which` of the block; fills `chromatic`.
void measure_result(const Block &block, int which, ConstRow p0, ConstRow p1, const Support &support,
                    ResultSums *sums, ContributorSums *contributors, Hues hues, const SquareRow &squares,
                    Row chromatic) {
    const Rules rules = block.rules;
    const float half_step = block.measures.half_step, achromatic = block.measures.achromatic;
    const int n = block.n;
    ConstRow luminances = block.luminance, total = block.total;
    Plane red, green, blue, foreign, of_near, of_others, values;
    for (int i = 0; i < n; ++i) {
        linear_from_p(rules, luminances[i], p0[i], p1[i], &red[i], &green[i], &blue[i]);
        float largest, difference, size;
        span_of(red[i], green[i], blue[i], &largest, &difference, &size);
        const bool has_chroma = support.size[i] > half_step;
        chromatic[i] = as_mask(has_chroma & (difference >= achromatic * size));
        foreign[i] = chromatic[i] * (1 - support.has_hue[i]);
        values[i] = chromatic[i] * support.size[i];
        // Those of the surviving hue share what is left of it; what goes beyond is the others'.
        of_near[i] = part_of(support.size[i], support.backing[i]);
        of_others[i] = part_of(support.size[i] - support.backing[i], total[i] - support.backing[i]);
    }
    const bool small = add_hues(block.measures, n, red, green, blue, block.alpha, support.size, hues);
    add_squares(squares, n, {red, green, blue, block.alpha}, small);
    sums->chromatic += count_of(chromatic, n);
    sums->chroma += sum_of(values, n, block.small);
    const int64_t foreigners = count_of(foreign, n);
    if (foreigners) {
        sums->foreign += foreigners;
        for (int i = 0; i < n; ++i) values[i] = foreign[i] * support.size[i];
        sums->foreign_chroma += sum_of(values, n, block.small);
    }
    const float *channels[3] = {red, green, blue};
    for (int channel = 0; channel < 3; ++channel) {
        for (int i = 0; i < n; ++i) values[i] = larger(channels[channel][i], 0.0f);
        sums->light[channel] += sum_of(values, n, small);
    }
    CellMask survives;
    uint8_t *const mask = survives.bytes + block.cell_left;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        ConstRow size = block.size + k * kBlock, near = block.near + k * kBlock;
        for (int i = 0; i < n; ++i) {
            mask[i] = (size[i] > half_step) & (chromatic[i] * near[i] != 0);
            values[i] = size[i] * (near[i] != 0 ? of_near[i] : of_others[i]);
        }
        const int place = block.places[block.numbers[k]];
        Cell *const cells = block.cells + int64_t(place) * block.cell_columns;
        contributors[place].survived += count_in_cells(block, survives, [=](int cell, int) {
            cells[cell].shown = uint16_t(cells[cell].shown | 1u << which);
        });
        contributors[place].kept += sum_of(values, n, block.small);
    }
}

void set_provenance(const Block &block, const Support &support, const Provenance &to) {
    const int n = block.n;
    Plane winner, size, x, y, runner_up;
    winners(block, support, winner, size);
    for (int i = 0; i < n; ++i) x[i] = y[i] = runner_up[i] = 0;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        const float *px = block.x(k), *py = block.y(k), number = float(block.numbers[k] + 1);
        for (int i = 0; i < n; ++i) {
            const bool is_winner = winner[i] == number;
            x[i] = is_winner ? px[i] : x[i];
            y[i] = is_winner ? py[i] : y[i];
        }
    }
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        const float *px = block.x(k), *py = block.y(k), *of = block.size + k * kBlock;
        for (int i = 0; i < n; ++i) {
            const float rival = holds(block.measures, x[i], y[i], px[i], py[i]) ? 0.0f : of[i];
            runner_up[i] = larger(rival, runner_up[i]);
        }
    }
    for (int i = 0; i < n; ++i) {
        const bool there = winner[i] != 0;
        to.layer[i] = uint32_t(winner[i]);
        to.grey[i] = block.total[i] > 0 ? 1 - part_of(support.size[i], block.total[i]) : 0.0f;
        to.margin[i] = there ? 1 - runner_up[i] / (there ? size[i] : 1.0f) : 0.0f;
    }
}

// The layers' terms added one by one, upwards or downwards, the background last.
void fold(const Block &block, bool upward, float *p0, float *p1) {
    const Rules rules = block.rules;
    const auto is_behind = [&](int k) { return k == block.layers || block.stack[block.numbers[k]].behind; };
    const auto add_term = [&](int turn, int k) {
        if (turn > 0) {
            add(rules, block.n, p0, p1, block.x(k), block.y(k), is_behind(k));
        } else {
            std::memcpy(p0, block.x(k), sizeof(Plane));
            std::memcpy(p1, block.y(k), sizeof(Plane));
        }
    };
    const int last = block.actives - 1;
    const bool background = block.active[last] == block.layers;
    const int layers = block.actives - background;
    for (int a = 0; a < layers; ++a) add_term(a, block.active[upward ? a : layers - 1 - a]);
    if (background) add_term(layers, block.layers);
}

// The chroma of the stack, in its own order.
void reduce(const Block &block, float *scratch, float *p0, float *p1) {
    const Order order = block.rules.order;
    if (order == Order::kBottomUp || order == Order::kFrontToBack) {
        fold(block, order == Order::kBottomUp, p0, p1);
        return;
    }
    const int count = block.layers;
    float *p = scratch;
    std::memcpy(p, block.p, size_t(count) * 2 * sizeof(Plane));
    float *kept = p + int64_t(count) * 2 * kBlock, *of_left = kept + int64_t(count) * kBlock;
    reduce_terms(block.rules, block.numbers, p, nullptr, count, block.n, kept, of_left,
                 of_left + int64_t(count) * kBlock);
    std::memcpy(p0, p, sizeof(Plane));
    std::memcpy(p1, p + kBlock, sizeof(Plane));
    if (block.actives && block.active[block.actives - 1] == count)
        add(block.rules, block.n, p0, p1, block.x(count), block.y(count), true);
}

bool is_nothing(const float *red, const float *green, const float *blue, const float *alpha, int n) {
    uint32_t any = 0;
    for (int i = 0; i < n; ++i)
        any |= bits_of(red[i]) | bits_of(green[i]) | bits_of(blue[i]) | bits_of(alpha[i]);
    return (any & 0x7fffffffu) == 0;
}

// Sizes of the terms, and which of them are anything here. Returns whether all can be measured.
bool find_active(Block &block, const float *luminance, Row total) {
    const uint32_t largest = bits_of(kLargestMeasured) - 1, sign = 0x80000000u;
    uint32_t beyond = 0;
    block.actives = 0;
    for (int i = 0; i < block.n; ++i) total[i] = 0;
    for (int k = 0; k <= block.layers; ++k) {
        ConstRow p0 = block.x(k), p1 = block.y(k), of = luminance + k * kBlock;
        Row size = block.size + k * kBlock;
        uint32_t any = 0;
        for (int i = 0; i < block.n; ++i) {
            size[i] = length(p0[i], p1[i]);
            total[i] += size[i];
            const uint32_t a = bits_of(p0[i]) & ~sign, b = bits_of(p1[i]) & ~sign;
            // Not of its size: the square of what is very small is 0.
            any |= a | b;
            beyond |= (largest - a) | (largest - b) | (largest - (bits_of(of[i]) & ~sign));
        }
        if (any) block.active[block.actives++] = k;
    }
    block.small = all_small(block.n, total);
    return (beyond & sign) == 0;
}

// Takes the chroma and the luminance from the pixels that cannot be measured, and makes their alpha
// NaN: they are still pixels of the histograms. Returns how many.
int take_out_unknown(int terms, int n, float *p, const float *luminance, float *sum, float *alpha) {
    int unknown = 0;
    for (int i = 0; i < n; ++i) {
        bool known = true;
        for (int k = 0; k < terms; ++k) {
            const float *p0 = p + int64_t(k) * 2 * kBlock + i;
            known &= (magnitude(luminance[k * kBlock + i]) < kLargestMeasured) &
                     (magnitude(p0[0]) < kLargestMeasured) &
                     (magnitude(p0[kBlock]) < kLargestMeasured);
        }
        if (known) continue;
        ++unknown;
        for (int k = 0; k < terms; ++k) {
            float *p0 = p + int64_t(k) * 2 * kBlock + i;
            p0[0] = p0[kBlock] = 0;
        }
        sum[i] = 0;
        alpha[i] = float_of(0x7fc00000u);
    }
    return unknown;
}

// How many pixels' survivor depends on the order; `support` is that of the stack's own.
int order_sensitive(const Block &block, const Support &support, const float *chromatic) {
    Plane upward, downward, size;
    const auto survivors = [&](Order order, float *winner) {
        if (block.rules.order == order) {
            winners(block, support, winner, size);
            return;
        }
        Plane q0, q1;
        Support other;
        fold(block, order == Order::kBottomUp, q0, q1);
        support_of(block, q0, q1, &other);
        winners(block, other, winner, size);
    };
    // The one that is at hand first: the other overwrites who is near.
    if (block.rules.order == Order::kFrontToBack) {
        survivors(Order::kFrontToBack, downward);
        survivors(Order::kBottomUp, upward);
    } else {
        survivors(Order::kBottomUp, upward);
        survivors(Order::kFrontToBack, downward);
    }
    int sensitive = 0;
    for (int i = 0; i < block.n; ++i)
        sensitive += (chromatic[i] != 0) & (upward[i] != downward[i]);
    return sensitive;
}

// The parts of a measurer's scratch, by terms: p twice as long as the others.
struct Scratch {
    float *p, *luminance, *alpha, *f_a, *f_b, *size, *near, *reducing;
    int *active, *numbers;

    // From term `first` on.
    explicit Scratch(const Measurer &of, int first = 0) {
        const int64_t row = int64_t(of.count + 1) * kBlock, skipped = int64_t(first) * kBlock;
        p = of.scratch + 2 * skipped;
        luminance = of.scratch + 2 * row + skipped;
        alpha = luminance + row, f_a = alpha + row, f_b = f_a + row, size = f_b + row, near = size + row;
        active = reinterpret_cast<int *>(of.scratch + 8 * row);
        numbers = reinterpret_cast<int *>(of.scratch + 9 * row) + first;
        reducing = of.scratch + 10 * row;
    }
};

Hues hues_of(const Measurer &of, int k) {
    return {of.found->hues + int64_t(k) * of.measures->bins * kHueColumns, of.found->others + k};
}

// Keeps a block of a layer as a term, and adds its colours to its histogram. Terms come bottom first, or from
// the front, and lie bottom first.
void observe_term(void *self, int number, int column, int row, int n, const float *red, const float *green,
                  const float *blue, const float *alpha, const float *luminance, const float *p0, const float *p1) {
    Measurer &of = *static_cast<Measurer *>(self);
    const int turn = of.terms++;
    const Scratch scratch(of, of.rules->order == Order::kFrontToBack ? of.count - 1 - turn : turn);
    float *x = scratch.p, *y = x + kBlock, *to = scratch.luminance;
    *scratch.numbers = number;
    std::memcpy(scratch.alpha, alpha, n * sizeof(float));
    const bool nothing = is_nothing(red, green, blue, alpha, n);
    if (nothing || n < kBlock) {
        // Lanes beyond the row take part in the reduction, and must be harmless.
        std::memset(x, 0, 2 * sizeof(Plane));
        std::memset(to, 0, sizeof(Plane));
    }
    if (nothing) return;
    const Hues hues = hues_of(of, of.places[number]);
    hues.others->transparent -= n;
    Plane chroma;
    ConstRow px = p0, py = p1;
    for (int i = 0; i < n; ++i) chroma[i] = length(px[i], py[i]);
    const bool small = add_hues(*of.measures, n, red, green, blue, alpha, chroma, hues);
    const SquareRow squares = SquareRow::of(of.found->squares, of.places[number], column, of.top + row);
    add_squares(squares, n, {red, green, blue, alpha}, small);
    std::memcpy(x, p0, n * sizeof(float));
    std::memcpy(y, p1, n * sizeof(float));
    std::memcpy(to, luminance, n * sizeof(float));
}

// Measures a block whose terms have all been kept.
void observe_block(void *self, int column, int row, int n) {
    Measurer &of = *static_cast<Measurer *>(self);
    const Rules &rules = *of.rules;
    const int measured = of.count, count = of.terms;
    const Scratch scratch(of, rules.order == Order::kFrontToBack ? measured - count : 0);
    of.terms = 0;
    scratch.numbers[count] = of.all;
    float *p = scratch.p, *luminance = scratch.luminance;
    Plane alpha, sum, total;
    for (int k = 0; k < count; ++k)
        factors(of.layers[scratch.numbers[k]], scratch.numbers[k], n, scratch.alpha + k * kBlock,
                scratch.f_a + k * kBlock, scratch.f_b + k * kBlock, alpha);
    weigh(count, n, scratch.f_a, scratch.f_b, p);
    for (int i = 0; i < n; ++i) sum[i] = 0;
    for (int k = 0; k < count; ++k) {
        for (int i = 0; i < n; ++i) {
            luminance[k * kBlock + i] *= scratch.f_a[k * kBlock + i];
            sum[i] += luminance[k * kBlock + i];  // [R1]
        }
    }
    if (rules.has_background) {
        float *below = p + int64_t(count) * 2 * kBlock, *light = luminance + count * kBlock;
        for (int i = 0; i < n; ++i) {
            const float uncovered = 1 - alpha[i];
            light[i] = uncovered * rules.background_luminance;
            sum[i] += light[i];
            below[i] = uncovered * rules.background_p[0];
            below[kBlock + i] = uncovered * rules.background_p[1];
            alpha[i] = 1;
        }
    } else {
        std::memset(p + int64_t(count) * 2 * kBlock, 0, 2 * sizeof(Plane));
        std::memset(luminance + count * kBlock, 0, sizeof(Plane));
    }
    const Cells &cells = of.found->cells;
    const int x = cells.left + column, y = cells.top + of.top + row;
    Cell *const first_cell = cells.first + int64_t(y / kCell) * (measured + 1) * cells.columns + x / kCell;
    Block block{rules, *of.measures, of.layers, n, count, scratch.numbers, of.places, p, scratch.size, scratch.near, scratch.active,
                0, false, sum, total, alpha, first_cell, cells.columns, x % kCell};
    if (!find_active(block, luminance, total)) {
        of.found->unmeasured += take_out_unknown(count + 1, n, p, luminance, sum, alpha);
        std::memset(luminance, 0, size_t(count + 1) * sizeof(Plane));
        find_active(block, luminance, total);
    }

    add_terms(block, of.found->contributors + int64_t(kBothResults) * (measured + 1));
    Plane p0, p1, chromatic;
    Support support;
    const auto measure_as = [&](int which) {
        support_of(block, p0, p1, &support);
        measure_result(block, which, p0, p1, support, of.found->results + which,
                       of.found->contributors + int64_t(which) * (measured + 1),
                       hues_of(of, measured + which),
                       SquareRow::of(of.found->squares, measured + which, column, of.top + row), chromatic);
    };
    for (int i = 0; i < n; ++i) p0[i] = p1[i] = 0;
    for (int a = 0; a < block.actives; ++a) {
        ConstRow x = block.x(block.active[a]), y = block.y(block.active[a]);
        for (int i = 0; i < n; ++i) p0[i] += x[i], p1[i] += y[i];
    }
    if (block.actives <= 1) {
        measure_as(kBothResults);  // nothing was blended
    } else {
        measure_as(kTraditional);
        reduce(block, scratch.reducing, p0, p1);
        measure_as(kAsBlended);
    }
    if (of.found->provenance.layer != nullptr) {
        const int64_t at = int64_t(of.top + row) * of.width + column;
        const Provenance &all = of.found->provenance;
        set_provenance(block, support, {all.layer + at, all.grey + at, all.margin + at});
    }
    if (of.measures->depends_on_order && block.actives > 2)  // two terms have no order
        of.found->order_sensitive += order_sensitive(block, support, chromatic);
}

}  // namespace

#define HPCOMP_JOINED(prefix, level) prefix##level
#define HPCOMP_SYMBOL(prefix, level) HPCOMP_JOINED(prefix, level)
extern const Measuring HPCOMP_SYMBOL(measuring_, HPCOMP_LEVEL);
const Measuring HPCOMP_SYMBOL(measuring_, HPCOMP_LEVEL) = {observe_term, observe_block};

}  // namespace hpcomp
