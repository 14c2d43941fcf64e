// The binding of the loops to Python: every array, size and number is checked here, so that the loops
// need not. All is passed by keyword, and choices as enums. Nothing is computed on pixels.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <tuple>
#include <type_traits>
#include <utility>

#include "binding.h"
#include "levels.h"
#include "manyterms.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace hpcomp {

namespace {

// Pixels of a band: its planes stay in the L2 cache beside the samples.
constexpr int kBandPixels = 1 << 12;

// Far below where sums of coordinates leave an int.
constexpr int64_t kFarthest = int64_t(1) << 29;

// Cells of all terms of a strip: far more than memory holds, far less than an int64 counts.
constexpr int64_t kMostCells = int64_t(1) << 48;

int checked_coordinate(int64_t value) {
    if (value < -kFarthest || value > kFarthest) throw nb::value_error("coordinate out of range");
    return int(value);
}

// Rows of two coefficients.
template <size_t kRows> using Pairs = std::array<std::array<float, 2>, kRows>;

template <size_t kRows> void copy(const Pairs<kRows> &from, float (&to)[kRows][2]) {
    for (size_t row = 0; row < kRows; ++row) std::copy(from[row].begin(), from[row].end(), to[row]);
}

using AnyArray = nb::ndarray<nb::ro, nb::device::cpu>;
using Table = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using FirstCodes = nb::ndarray<const uint16_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

Sample sample_of(nb::dlpack::dtype type) {
    if (type == nb::dtype<uint8_t>()) return Sample::kU8;
    if (type == nb::dtype<uint16_t>()) return Sample::kU16;
    if (type == nb::dtype<float>()) return Sample::kFloat;
    if (is_half(type)) return Sample::kHalf;
    throw nb::type_error("samples must be uint8, uint16, float16 or float32");
}

// A layer's strip, and what keeps its arrays alive.
struct StripLayer {
    Layer layer{};
    AnyArray samples;
    Table decode;
};

StripLayer make_layer(AnyArray samples, std::optional<Table> decode, bool alpha_straight,
                      const std::optional<Pairs<3>> &matrix, int64_t left, int64_t top,
                      float opacity, Factor factor_a, Factor factor_b, bool behind, bool zero_nonfinite) {
    StripLayer made;
    Layer &layer = made.layer;
    if (samples.ndim() != 3) throw nb::value_error("samples must be rows x columns x channels");
    layer.type = sample_of(samples.dtype());
    const int64_t channels = int64_t(samples.shape(2)), width = int64_t(samples.shape(1));
    const int64_t height = int64_t(samples.shape(0)), bytes = samples.dtype().bits / 8;
    if (channels < 1 || channels > 4) throw nb::value_error("samples must have 1 to 4 channels");
    if (samples.size() != 0 &&
        ((channels > 1 && samples.stride(2) != 1) || (width > 1 && samples.stride(1) != channels)))
        throw nb::value_error("the samples of a row must be contiguous");
    check_aligned(samples.data(), bytes);
    const bool codes = layer.type == Sample::kU8 || layer.type == Sample::kU16;
    if (codes) {
        const size_t needed = layer.type == Sample::kU8 ? 256 : 65536;
        if (!decode || decode->shape(0) != needed)
            throw nb::value_error("integer samples need a table with a value for each code");
        check_aligned(decode->data(), sizeof(float));
        made.decode = *decode;
        layer.decode = made.decode.data();
    }
    layer.samples = samples.data();
    layer.row_bytes = height > 1 ? int64_t(samples.stride(0)) * bytes : 0;
    layer.channels = int(channels);
    layer.alpha_straight = alpha_straight;
    layer.has_matrix = matrix.has_value();
    if (matrix) copy(*matrix, layer.matrix);
    layer.left = checked_coordinate(left);
    layer.top = checked_coordinate(top);
    layer.width = checked_coordinate(width);
    layer.height = checked_coordinate(height);
    if (!(opacity >= 0 && opacity <= 1)) throw nb::value_error("opacity must be from 0 to 1");
    layer.opacity = opacity;
    layer.factor_a = factor_a;
    layer.factor_b = factor_b;
    layer.behind = behind;
    layer.zero_nonfinite = zero_nonfinite;
    made.samples = std::move(samples);
    return made;
}

SpaceMaps make_plane(Maps maps, float weight_red, float weight_blue, const Pairs<2> &to_p,
                     const Pairs<3> &from_p) {
    SpaceMaps made{};
    made.maps = maps, made.weight_red = weight_red, made.weight_blue = weight_blue;
    copy(to_p, made.to_p);
    copy(from_p, made.from_p);
    return made;
}

SpaceMaps make_linear(float weight_red, float weight_blue, const Pairs<2> &to_p, const Pairs<3> &from_p) {
    return make_plane(Maps::kLinear, weight_red, weight_blue, to_p, from_p);
}

SpaceMaps make_hsl(float weight_red, float weight_blue, const Pairs<2> &to_p, const Pairs<3> &from_p) {
    return make_plane(Maps::kHsl, weight_red, weight_blue, to_p, from_p);
}

// Where curves of one hue go out of gamut and come back, p is scaled to so far outside it.
SpaceMaps with_slack(SpaceMaps made, float slack_lo, float slack_hi) {
    if (!(slack_lo >= 0 && slack_hi >= 0)) throw nb::value_error("the slack of a gamut is not negative");
    made.slack_lo = slack_lo, made.slack_hi = slack_hi;
    return made;
}

float checked_bound(float inverse_largest) {
    if (!(inverse_largest > 0)) throw nb::value_error("the bound of |p|/Y must be positive");
    return inverse_largest;
}

SpaceMaps make_oklab(float weight_red, float weight_blue, const Pairs<3> &to_lms, const Pairs<3> &to_lab,
                     const Pairs<3> &to_roots, const Pairs<3> &from_lms, float inverse_largest,
                     float slack_lo, float slack_hi) {
    SpaceMaps made{};
    made.maps = Maps::kOklab, made.weight_red = weight_red, made.weight_blue = weight_blue;
    copy(to_lms, made.oklab.to_lms);
    copy(to_lab, made.oklab.to_lab);
    copy(to_roots, made.oklab.to_roots);
    copy(from_lms, made.oklab.from_lms);
    made.oklab.inverse_largest = checked_bound(inverse_largest);
    return with_slack(made, slack_lo, slack_hi);
}

SpaceMaps make_cielab(float weight_red, float weight_blue, const Pairs<2> &to_xz, const Pairs<3> &from_xz,
                      float inverse_largest, float slack_lo, float slack_hi) {
    SpaceMaps made{};
    made.maps = Maps::kCielab, made.weight_red = weight_red, made.weight_blue = weight_blue;
    copy(to_xz, made.cielab.to_xz);
    copy(from_xz, made.cielab.from_xz);
    made.cielab.inverse_largest = checked_bound(inverse_largest);
    return with_slack(made, slack_lo, slack_hi);
}

// A colour that lies below the stack, what bounds its channels, and how strong it is.
struct Background {
    float luminance, p[2], rgb[3], bounds[2], strength;
};

Background make_background(float luminance, std::array<float, 2> p, std::array<float, 3> rgb, float lo,
                           float hi, float strength) {
    return {luminance, {p[0], p[1]}, {rgb[0], rgb[1], rgb[2]}, {lo, hi}, strength};
}

// How strong colours are, but for their chroma.
struct Competition {
    Strength strength;
    OklabNumbers perception;
    float half_chroma;
};

Competition make_competition(Strength strength, const SpaceMaps &oklab, float half_chroma) {
    if (oklab.maps != Maps::kOklab) throw nb::value_error("strengths are measured in Oklab");
    if (!(half_chroma > 0)) throw nb::value_error("the chroma of half the strength must be positive");
    return {strength, oklab.oklab, half_chroma};
}

// A pattern with the tile that it points to: a copy, as nobody is to change it.
struct WeaveTile {
    Weave weave{};
    std::vector<uint16_t> tile;
};

using Tile = nb::ndarray<const uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

WeaveTile make_weave(Pattern pattern, int size, const std::optional<Tile> &tile) {
    WeaveTile made;
    if (size < 1 || size > (1 << 20)) throw nb::value_error("the size of a weave is out of range");
    if ((pattern == Pattern::kNoise) != tile.has_value()) throw nb::value_error("noise needs a tile, stripes none");
    made.weave = {pattern, size, nullptr, 0};
    if (!tile) return made;
    const size_t side = tile->shape(0);
    if (side < 1 || side > 256 || tile->shape(1) != side) throw nb::value_error("a tile is a square");
    check_aligned(tile->data(), sizeof(uint16_t));
    made.tile.assign(tile->data(), tile->data() + side * side);
    for (const uint16_t number : made.tile)
        if (number >= side * side) throw nb::value_error("a number out of range");
    made.weave.side = int(side);
    return made;
}

// Rules with the permutation and the tile that they point to.
struct StackRules {
    Rules rules{};
    std::vector<int> permutation;
    std::vector<uint16_t> tile;
};

std::shared_ptr<StackRules> make_rules(Blending blending, float hue_tolerance, float rounding_angle,
                                       float gray_bias, Order order, std::vector<int> permutation,
                                       int layers, const Background *background, float gain,
                                       const SpaceMaps &space, const Competition *competition,
                                       const WeaveTile *weave) {
    auto made = std::make_shared<StackRules>();
    Rules &rules = made->rules;
    if (layers < 1 || layers > (1 << 20)) throw nb::value_error("a stack needs layers");
    // The folds of other orders do not know who is in front.
    if (blending == Blending::kForemost && order != Order::kBottomUp)
        throw nb::value_error("the foremost is found from the bottom up");
    if ((blending == Blending::kWoven) != (order == Order::kWoven) || (weave != nullptr) != (order == Order::kWoven))
        throw nb::value_error("woven terms have an order of their own, and a weave");
    if (!(gray_bias >= 0 && gray_bias <= 1)) throw nb::value_error("gray bias must be from 0 to 1");
    if (order == Order::kPermutation) {
        std::vector<bool> seen(size_t(layers), false);
        if (permutation.size() != size_t(layers)) throw nb::value_error("not a permutation");
        for (const int number : permutation) {
            if (number < 0 || number >= layers || seen[size_t(number)])
                throw nb::value_error("not a permutation");
            seen[size_t(number)] = true;
        }
    }
    made->permutation = std::move(permutation);
    static_cast<SpaceMaps &>(rules) = space;
    rules.blending = blending;
    rules.bounded = space.maps != Maps::kLinear || blending == Blending::kWoven;
    rules.strength = competition ? competition->strength : Strength::kChroma;
    if (competition) rules.perception = competition->perception, rules.half_chroma = competition->half_chroma;
    if (weave) {
        made->tile = weave->tile;
        rules.weave = weave->weave;
        rules.weave.tile = made->tile.data();
    }
    rules.rounding_angle = rounding_angle;
    rules.gray_power = 3 * gray_bias;
    // No tolerance is below what float rounding turns a vector by, and without one the switch is hard.
    rules.tolerance = std::max(hue_tolerance, rounding_angle);
    rules.inverse_tolerance = hue_tolerance > 0 ? 1 / rules.tolerance : 0;
    const float end = hue_tolerance > 0 ? std::min(2 * rules.tolerance, 3.14159265f) : rules.tolerance;
    rules.end_sine = std::sin(end);
    rules.end_cosine = std::cos(end);
    rules.order = order;
    rules.permutation = made->permutation.data();
    rules.layers = layers;
    rules.has_background = background != nullptr;
    if (background) {
        rules.background_luminance = background->luminance;
        std::copy(std::begin(background->p), std::end(background->p), rules.background_p);
        std::copy(std::begin(background->rgb), std::end(background->rgb), rules.background_rgb);
        std::copy(std::begin(background->bounds), std::end(background->bounds), rules.background_bounds);
        rules.background_strength = background->strength;
    }
    rules.gain = gain;
    return made;
}

// Codes with the tables that they point to: copies, which nobody changes once they are checked.
struct CodeTables {
    Codes codes{};
    std::vector<float> thresholds;
    std::vector<uint16_t> first_code;
};

std::shared_ptr<CodeTables> make_codes(Table thresholds, FirstCodes first_code, int bucket_bits,
                                       float smallest, float lowest, float darkest, float highest,
                                       const std::optional<Pairs<3>> &matrix,
                                       std::array<double, 3> luminance_weights, const SpaceMaps &space) {
    auto made = std::make_shared<CodeTables>();
    const size_t count = thresholds.shape(0);
    if (count != 256 && count != 65536)
        throw nb::value_error("integer output needs a threshold for each code");
    check_aligned(thresholds.data(), sizeof(float));
    made->thresholds.assign(thresholds.data(), thresholds.data() + count);
    // The last one is infinite: no value passes it, and no code beyond it exists.
    for (size_t i = 0; i < count; ++i)
        if (!(made->thresholds[i] > (i ? made->thresholds[i - 1] : 0.0f)))
            throw nb::value_error("thresholds must increase");
    if (made->thresholds.back() != std::numeric_limits<float>::infinity())
        throw nb::value_error("the last threshold must be infinite");
    if (bucket_bits < 1 || bucket_bits > 16) throw nb::value_error("bucket_bits out of range");
    int octaves = 0;
    for (float edge = smallest; edge > 0 && edge < 1 && octaves < 64; edge *= 2) ++octaves;
    if (!(smallest > 0) || octaves < 1 || octaves >= 64 || std::ldexp(1.0f, -octaves) != smallest)
        throw nb::value_error("buckets must begin at a power of two below 1");
    if (first_code.shape(0) != (size_t(octaves) << bucket_bits) + 1)
        throw nb::value_error("a first code for each bucket is needed");
    check_aligned(first_code.data(), sizeof(uint16_t));
    made->first_code.assign(first_code.data(), first_code.data() + first_code.shape(0));
    for (const uint16_t code : made->first_code)
        if (code >= count) throw nb::value_error("a first code out of range");
    Codes &codes = made->codes;
    codes.thresholds = made->thresholds.data();
    codes.first_code = made->first_code.data();
    codes.bucket_bits = bucket_bits;
    codes.smallest = smallest;
    codes.lowest = lowest;
    codes.darkest = darkest;
    codes.highest = highest;
    codes.has_matrix = matrix.has_value();
    if (matrix) copy(*matrix, codes.matrix);
    std::copy(luminance_weights.begin(), luminance_weights.end(), codes.weights);
    codes.space = space;
    return made;
}

using Numbers = nb::ndarray<uint32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Values = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Planes of provenance, which are written to.
struct ProvenancePlanes {
    Numbers layer;
    Values grey, margin;
};

template <class Array> auto *checked_plane(const Array &array, int64_t height, int64_t width) {
    if (int64_t(array.shape(0)) != height || int64_t(array.shape(1)) != width)
        throw nb::value_error("provenance must be height x width");
    check_aligned(array.data(), sizeof(*array.data()));
    return array.data();
}

// The sums that the measures of a strip are added to, see `measure.h`, and its planes of provenance.
struct StripMeasures {
    MeasureRules rules{};
    Measures found{};
    int64_t layers, width, height;
    std::vector<ResultSums> results;
    std::vector<ContributorSums> contributors;
    std::vector<Cell> cells;
    std::vector<int64_t> hues;
    std::vector<OtherPixels> others;
    std::vector<int64_t> squares;
    std::optional<ProvenancePlanes> provenance;
};

// Where in its cell a coordinate of the canvas is.
int within_cell(int64_t coordinate) { return int((coordinate % kCell + kCell) % kCell); }

std::unique_ptr<StripMeasures> make_measures(int64_t layers, int64_t width, int64_t height, int64_t left,
                                             int64_t top, int64_t bins, float half_step, float achromatic,
                                             float foreign_sine, float foreign_cosine, bool depends_on_order,
                                             const ProvenancePlanes *provenance, int64_t square_scale,
                                             int64_t square_top) {
    if (layers < 1 || layers > (1 << 20)) throw nb::value_error("a stack needs layers");
    if (checked_coordinate(width) < 1 || checked_coordinate(height) < 1)
        throw nb::value_error("a strip needs pixels");
    if (bins < 1 || bins > (1 << 16)) throw nb::value_error("hues need bins");
    auto made = std::make_unique<StripMeasures>();
    made->rules = {half_step, achromatic, foreign_sine, foreign_cosine, depends_on_order, int(bins)};
    made->layers = layers, made->width = width, made->height = height;
    made->results.resize(kResults);
    made->contributors.resize(size_t(kResults * (layers + 1)));
    Cells &cells = made->found.cells;
    cells.left = within_cell(left), cells.top = within_cell(top);
    cells.columns = int((cells.left + width - 1) / kCell) + 1;
    const int64_t cell_rows = (cells.top + height - 1) / kCell + 1;
    if (cell_rows > kMostCells / (layers + 1) / cells.columns) throw nb::value_error("a strip of too many cells");
    made->cells.resize(size_t(cell_rows * (layers + 1) * cells.columns));
    cells.first = made->cells.data();
    made->hues.resize(size_t((layers + kResults) * bins * kHueColumns));
    made->others.resize(size_t(layers + kResults));
    made->found.results = made->results.data();
    made->found.contributors = made->contributors.data();
    made->found.hues = made->hues.data();
    made->found.others = made->others.data();
    if (square_scale > 0) {
        Squares &squares = made->found.squares;
        if (square_top < 0 || square_top >= checked_coordinate(square_scale))
            throw nb::value_error("squares begin less than their side above the strip");
        squares.scale = int(square_scale), squares.top = int(square_top);
        squares.rows = int((square_top + height - 1) / square_scale) + 1;
        squares.columns = int((width - 1) / square_scale) + 1;
        made->squares.resize(size_t(layers + kResults) * size_t(squares.rows) * size_t(squares.columns) * 4);
        squares.first = made->squares.data();
    }
    if (provenance) {
        made->found.provenance = {checked_plane(provenance->layer, height, width),
                                  checked_plane(provenance->grey, height, width),
                                  checked_plane(provenance->margin, height, width)};
        made->provenance = *provenance;
    }
    return made;
}

// --- measures read out: those of pixels that are the same in both results are in each ------------

using Column = nb::ndarray<nb::numpy, int64_t, nb::ndim<1>>;
using Columns = nb::ndarray<nb::numpy, int64_t, nb::ndim<2>>;

// A hue histogram: pixel counts and sums by bin, and the pixels without one.
struct HueSums {
    std::vector<int64_t> count, chroma, alpha, rgb;  // (bins), the last (bins, 3)
    OtherPixels others{};

    explicit HueSums(const StripMeasures &of) {
        const size_t bins = size_t(of.rules.bins);
        count.resize(bins), chroma.resize(bins), alpha.resize(bins), rgb.resize(3 * bins);
    }

    HueSums &add(const StripMeasures &of, int64_t histogram) {
        const int64_t *row = of.hues.data() + histogram * of.rules.bins * kHueColumns;
        for (size_t bin = 0; bin < count.size(); ++bin, row += kHueColumns) {
            count[bin] += row[kCount], chroma[bin] += row[kChroma], alpha[bin] += row[kAlpha];
            rgb[3 * bin] += row[kRed], rgb[3 * bin + 1] += row[kGreen], rgb[3 * bin + 2] += row[kBlue];
        }
        const OtherPixels &more = of.others[size_t(histogram)];
        others.grey += more.grey, others.transparent += more.transparent;
        others.nonfinite += more.nonfinite;
        return *this;
    }
};

HueSums hues_of_layer(const StripMeasures &of, int64_t number) {
    if (number < 0 || number >= of.layers) throw nb::value_error("no layer has that number");
    return HueSums(of).add(of, number);
}

template <Result kWhich> HueSums hues_of_result(const StripMeasures &of) {
    return HueSums(of).add(of, of.layers + kWhich).add(of, of.layers + kBothResults);
}

// An array of the histogram's own memory, which it keeps alive.
template <std::vector<int64_t> HueSums::*kColumn> Column column_of(HueSums &of) {
    return Column((of.*kColumn).data(), {(of.*kColumn).size()});
}

Columns rgb_of(HueSums &of) { return Columns(of.rgb.data(), {of.count.size(), 3}); }

using SquareSums = nb::ndarray<nb::numpy, int64_t, nb::ndim<3>>;

const Squares &checked_squares(const StripMeasures &of) {
    if (of.found.squares.first == nullptr) throw nb::value_error("no squares were asked for");
    return of.found.squares;
}

template <Result kWhich> SquareSums squares_of_result(const StripMeasures &of) {
    const Squares &squares = checked_squares(of);
    const size_t rows = size_t(squares.rows), columns = size_t(squares.columns), size = rows * columns * 4;
    const int64_t *const own = squares.first + size_t(of.layers + kWhich) * size;
    const int64_t *const both = squares.first + size_t(of.layers + kBothResults) * size;
    auto sums = std::make_unique<std::vector<int64_t>>(own, own + size);
    for (size_t i = 0; i < size; ++i) (*sums)[i] += both[i];
    int64_t *const first = sums->data();
    const nb::capsule owner(
        sums.release(), [](void *held) noexcept { delete static_cast<std::vector<int64_t> *>(held); });
    return SquareSums(first, {rows, columns, 4}, owner);
}

// The memory of the measures themselves, which it keeps alive.
SquareSums squares_of_layer(StripMeasures &of, int64_t number) {
    const Squares &squares = checked_squares(of);
    if (number < 0 || number >= of.layers) throw nb::value_error("no layer has that number");
    const size_t rows = size_t(squares.rows), columns = size_t(squares.columns);
    return SquareSums(squares.first + size_t(number) * rows * columns * 4, {rows, columns, 4}, nb::find(of));
}

// One result, its contributors being the layers, bottom first, and then the background.
struct ResultFound {
    ResultSums sums;
    std::vector<ContributorSums> contributors;
};

template <Result kWhich> ResultFound found_of(const StripMeasures &of) {
    ResultFound found{{}, std::vector<ContributorSums>(size_t(of.layers + 1))};
    for (const int which : {int(kWhich), int(kBothResults)}) {
        const ResultSums &more = of.results[size_t(which)];
        found.sums.chromatic += more.chromatic, found.sums.chroma += more.chroma;
        found.sums.foreign += more.foreign, found.sums.foreign_chroma += more.foreign_chroma;
        for (int channel = 0; channel < 3; ++channel) found.sums.light[channel] += more.light[channel];
        const ContributorSums *added = of.contributors.data() + which * (of.layers + 1);
        for (ContributorSums &sums : found.contributors) {
            sums.pixels += added->pixels, sums.survived += added->survived;
            sums.chroma += added->chroma, sums.kept += added->kept;
            ++added;
        }
    }
    const size_t columns = size_t(of.found.cells.columns);
    for (auto cell = of.cells.begin(); cell != of.cells.end();)
        for (ContributorSums &sums : found.contributors)
            for (size_t column = 0; column < columns; ++column, ++cell)
                if (cell->shown & (1u << kWhich | 1u << kBothResults)) sums.visible += cell->pixels;
    return found;
}

using Phases = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// Layers of a strip by number, in the order in which they came.
struct HeldLayers {
    std::vector<int> numbers;
    std::vector<StripLayer> strips;

    void add(int number, const StripLayer &strip) { numbers.push_back(number), strips.push_back(strip); }

    void add(const HeldLayers &more) {
        numbers.insert(numbers.end(), more.numbers.begin(), more.numbers.end());
        strips.insert(strips.end(), more.strips.begin(), more.strips.end());
    }

    std::vector<Layer> layers() const {
        std::vector<Layer> made;
        for (const StripLayer &strip : strips) made.push_back(strip.layer);
        return made;
    }
};

class Accumulator {
  public:
    // `left`, `top`: of its first pixel, from the corner of the canvas. `phases`: of the weave in all its pixels,
    // where they do not lie side by side there.
    Accumulator(std::shared_ptr<StackRules> rules, int64_t width, int64_t height, int64_t left, int64_t top,
                const std::optional<Phases> &phases, const std::string &level)
        : rules_(std::move(rules)), level_(level_of(level)), engine_(level_.engine),
          width_(checked_coordinate(width)), height_(checked_coordinate(height)) {
        state_.left = checked_coordinate(left), state_.top = checked_coordinate(top);
        if (width < 1 || height < 1) throw nb::value_error("a strip needs pixels");
        if (!phases) return;
        if (int64_t(phases->shape(0)) != width * height) throw nb::value_error("a phase for each pixel is needed");
        check_aligned(phases->data(), sizeof(float));
        phases_.assign(phases->data(), phases->data() + width * height);
        state_.phase = phases_.data();
    }

    // Takes layers in their turn; null are those that have no pixels in the strip and erase nothing. Returns how
    // many pixels of each are NaN or infinite; where layers wait for all the others, `result` tells.
    std::vector<int64_t> add(const std::vector<int> &numbers, std::vector<StripLayer *> strips) {
        if (numbers.size() != strips.size()) throw nb::value_error("a number for each layer");
        const int layers_in_all = rules_->rules.layers;
        if (numbers.size() > size_t(layers_in_all - come_)) throw nb::value_error("too many layers");
        const bool from_front = rules_->rules.order == Order::kFrontToBack;
        for (size_t i = 0; i < numbers.size(); ++i) {
            const int turn = come_ + int(i);
            if (numbers[i] != (from_front ? layers_in_all - 1 - turn : turn))
                throw nb::value_error("layers out of order");
            if (numbers[i] == 0 && strips[i] == nullptr) throw nb::value_error("the bottom layer is needed");
        }
        come_ += int(numbers.size());
        waits_ = !folds() || int(numbers.size()) == layers_in_all;
        // Copies, which keep the arrays alive while other threads run.
        HeldLayers taken;
        for (size_t i = 0; i < numbers.size(); ++i)
            if (strips[i]) taken.add(numbers[i], *strips[i]);
        std::vector<int64_t> nonfinite(numbers.size(), 0);
        if (waits_) {
            held_.add(taken);
            return nonfinite;
        }
        if (planes_.empty()) begin_planes(height_);
        std::vector<int64_t> counts(taken.numbers.size(), 0);
        std::vector<Layer> layers = taken.layers();
        {
            const nb::gil_scoped_release unlocked;
            engine_->add(rules_->rules, layers.data(), taken.numbers.data(), int(layers.size()), width_, height_,
                         state_, counts.data(), nullptr);
        }
        for (size_t i = 0, k = 0; i < numbers.size(); ++i)
            if (strips[i]) nonfinite[i] = counts[k++];
        return nonfinite;
    }

    // Writes the strip to `out`, and measures it if all layers came at once; returns what could not be
    // written as it is, and how many pixels of each layer, by its number, are NaN or infinite.
    std::pair<Losses, std::vector<int64_t>> result(nb::ndarray<nb::device::cpu, nb::c_contig> out,
                                                   std::shared_ptr<CodeTables> codes,
                                                   StripMeasures *measures) {
        if (out.ndim() != 3 || int64_t(out.shape(0)) != height_ || int64_t(out.shape(1)) != width_ ||
            out.shape(2) != 4)
            throw nb::value_error("out must be height x width x 4");
        check_aligned(out.data(), out.dtype().bits / 8);
        check_finished(measures);
        Output output{};
        output.samples = out.data();
        output.type = sample_of(out.dtype());
        const size_t needed = output.type == Sample::kU8 ? 256 : output.type == Sample::kU16 ? 65536 : 0;
        if ((codes ? codes->thresholds.size() : 0) != needed)
            throw nb::value_error("integer output needs the codes of its depth, floats none");
        if (codes) static_cast<Codes &>(output) = codes->codes;
        finished_ = true;
        const HeldLayers held = std::move(held_);
        std::vector<int64_t> nonfinite(size_t(rules_->rules.layers), 0);
        Losses losses{};
        {
            const nb::gil_scoped_release unlocked;
            if (waits_)
                reduce_in_bands(held, &output, int64_t(out.dtype().bits / 8), &losses, &nonfinite, measures);
            else
                engine_->finish(rules_->rules, int64_t(height_) * width_, state_, output, &losses);
        }
        return {losses, nonfinite};
    }

    // Measures the strip alone.
    void measure(StripMeasures &measures) {
        check_finished(&measures);
        finished_ = true;
        const HeldLayers held = std::move(held_);
        const nb::gil_scoped_release unlocked;
        reduce_in_bands(held, nullptr, 0, nullptr, nullptr, &measures);
    }

  private:
    void check_finished(const StripMeasures *measures) const {
        if (come_ != rules_->rules.layers) throw nb::value_error("not all layers have come");
        if (finished_) throw nb::value_error("the result has been taken");
        if (measures == nullptr) return;
        if (!waits_) throw nb::value_error("layers are measured when all come at once");
        if (rules_->rules.bounded || rules_->rules.strength != Strength::kChroma)
            throw nb::value_error("linear spaces and the chroma in them alone are measured");
        if (measures->layers != int64_t(held_.numbers.size()) || measures->width != width_ || measures->height != height_)
            throw nb::value_error("measures of another strip");
    }

    bool folds() const {
        return rules_->rules.order == Order::kBottomUp || rules_->rules.order == Order::kFrontToBack;
    }

    // Planes of so many rows. The bottom layer and reductions write all of them; from the front, layers
    // come under nothing: no light, no alpha, full transmittance.
    void begin_planes(int64_t rows) {
        const int64_t pixels = rows * width_;
        const bool front = rules_->rules.order == Order::kFrontToBack;
        const bool bounded = rules_->rules.bounded, strong = rules_->rules.strength != Strength::kChroma;
        const int count = 7 + (front ? 1 : 0) + (bounded ? 2 : 0) + (strong ? 1 : 0);
        if (planes_.empty()) planes_.resize(size_t(pixels) * size_t(count));
        float *const first = planes_.data(), *const last = first + count * pixels, *plane = first;
        const auto next = [&plane, pixels] { return (plane += pixels) - pixels; };
        // Braces take them in this order.
        state_.light = Light{next(), next(), next(), next(), next(), next(), nullptr};
        state_.alpha = next();
        state_.transmittance = front ? next() : nullptr;
        state_.lo = bounded ? next() : nullptr;
        state_.hi = bounded ? next() : nullptr;
        state_.light.strength = strong ? next() : nullptr;
        if (!front) return;
        std::fill(first, last, 0.0f);
        std::fill(state_.transmittance, state_.transmittance + pixels, 1.0f);
    }

    // All layers, from samples to samples in bands whose planes stay in cache. Without an output the
    // layers are measured alone.
    void reduce_in_bands(const HeldLayers &held, const Output *output, int64_t sample_bytes, Losses *losses,
                         std::vector<int64_t> *nonfinite, StripMeasures *measures) {
        const Rules &rules = rules_->rules;
        std::vector<Layer> layers = held.layers();
        const std::vector<int> &numbers = held.numbers;
        const int n = int(layers.size());
        std::vector<int64_t> counts(layers.size(), 0);
        std::vector<float> scratch(folds() ? 0 : size_t(scratch_floats(rules.order, n, rules.layers)));
        std::vector<float> measuring;
        std::vector<Layer> by_number;
        std::vector<int> places;
        Measurer measurer{};
        if (measures) {
            measuring.resize(size_t(measure_floats(rules.order, n, rules.layers)));
            by_number.resize(size_t(rules.layers));
            places.assign(size_t(rules.layers) + 1, n);
            for (size_t k = 0; k < layers.size(); ++k) {
                by_number[size_t(numbers[k])] = layers[k];
                places[size_t(numbers[k])] = rules.order == Order::kFrontToBack ? n - 1 - int(k) : int(k);
            }
            // Until its pixels come, a layer is transparent.
            for (int k = 0; k < n; ++k) measures->found.others[k].transparent += int64_t(width_) * height_;
            measurer = {&rules, &measures->rules, by_number.data(), places.data(), rules.layers, n, width_, 0, 0,
                        measuring.data(), &measures->found};
        }
        const Observer watching{&measurer, level_.measuring->term, level_.measuring->block};
        const Observer *observer = measures ? &watching : nullptr;
        const int band = std::max(1, kBandPixels / width_);
        for (int y = 0; y < height_; y += band) {
            const int rows = std::min(band, height_ - y);
            begin_planes(rows);
            measurer.top = y;
            if (folds())
                engine_->add(rules, layers.data(), numbers.data(), n, width_, rows, state_, counts.data(),
                             observer);
            else
                engine_->reduce(rules, layers.data(), numbers.data(), n, width_, rows, state_, scratch.data(),
                                counts.data(), observer);
            if (output) {
                Output part = *output;
                part.samples = static_cast<char *>(output->samples) + 4 * sample_bytes * width_ * y;
                engine_->finish(rules, int64_t(rows) * width_, state_, part, losses);
            }
            for (Layer &layer : layers) layer.top -= rows;
            state_.top += rows;
            if (state_.phase) state_.phase += int64_t(rows) * width_;
        }
        for (size_t k = 0; nonfinite && k < counts.size(); ++k) (*nonfinite)[size_t(numbers[k])] = counts[k];
    }

    std::shared_ptr<StackRules> rules_;
    const Level &level_;
    const Engine *engine_;
    int width_, height_;
    std::vector<float> planes_, phases_;
    State state_{};
    HeldLayers held_;
    int come_ = 0;  // how many layers have
    bool waits_ = true;     // for all layers, which are held until then
    bool finished_ = false;
};

using Counts = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Vectors = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Strengths = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Kept = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// What is kept of the chroma vectors p (2, all of the runs) of each run, added at once: factors `kept`.
void keep_runs(std::shared_ptr<StackRules> rules, Counts counts, Vectors p, std::optional<Strengths> strengths,
               Kept kept) {
    const int64_t runs = int64_t(counts.shape(0)), in_all = int64_t(p.shape(1));
    if (p.shape(0) != 2) throw nb::value_error("p must be two planes");
    if (int64_t(kept.shape(0)) != in_all) throw nb::value_error("a factor for each vector is needed");
    check_aligned(counts.data(), sizeof(int64_t));
    check_aligned(p.data(), sizeof(double));
    check_aligned(kept.data(), sizeof(double));
    if (strengths && int64_t(strengths->shape(0)) != in_all)
        throw nb::value_error("a strength for each vector is needed");
    if (strengths) check_aligned(strengths->data(), sizeof(double));
    if (rules->rules.blending == Blending::kForemost || rules->rules.blending == Blending::kWoven)
        throw nb::value_error("none of what is added at once is in front, or anywhere");
    int64_t left = in_all, longest = 0;
    for (int64_t run = 0; run < runs; ++run) {
        const int64_t count = counts.data()[run];
        if (count < 0 || count > left || count > (1 << 30)) throw nb::value_error("runs of other lengths");
        left -= count;
        longest = std::max(longest, count);
    }
    if (left != 0) throw nb::value_error("runs of other lengths");
    const nb::gil_scoped_release unlocked;
    std::fill(kept.data(), kept.data() + in_all, 1.0);
    if (rules->rules.blending == Blending::kTraditional) return;
    const double *x = p.data(), *y = x + in_all;
    double *factors = kept.data();
    const double *m = strengths ? strengths->data() : nullptr;
    std::vector<double> scratch(size_t(run_doubles(longest)));
    double *terms = scratch.data(), *of_terms = terms + 2 * longest, *strong = of_terms + longest;
    double *sorting = strong + longest;
    for (int64_t run = 0; run < runs; ++run) {
        const int64_t count = counts.data()[run];
        int n = 0;
        for (int64_t k = 0; k < count; ++k) {
            if (x[k] == 0 && y[k] == 0) continue;
            terms[2 * int64_t(n)] = x[k], terms[2 * int64_t(n) + 1] = y[k];
            if (m) strong[n] = m[k];
            of_terms[n++] = 1;
        }
        if (n > 0) keep_of_many(rules->rules, terms, m ? strong : nullptr, n, sorting, of_terms);
        n = 0;
        for (int64_t k = 0; k < count; ++k)
            if (!(x[k] == 0 && y[k] == 0)) factors[k] = of_terms[n++];
        x += count, y += count, factors += count;
        if (m) m += count;
    }
}

// Measures all layers of a strip without compositing it.
void measure(std::shared_ptr<StackRules> rules, const std::vector<StripLayer *> &strips,
             StripMeasures &measures, const std::string &level) {
    const int layers = int(strips.size());
    Accumulator strip(rules, measures.width, measures.height, 0, 0, std::nullopt, level);
    std::vector<int> numbers(strips.size());
    const bool from_front = rules->rules.order == Order::kFrontToBack;
    for (int i = 0; i < layers; ++i) numbers[size_t(i)] = from_front ? layers - 1 - i : i;
    std::vector<StripLayer *> arriving = strips;
    if (from_front) std::reverse(arriving.begin(), arriving.end());
    strip.add(numbers, arriving);
    strip.measure(measures);
}

}  // namespace

NB_MODULE(_kernel, module) {
    module.doc() = "The loops of the fused engine, whose face is hpcomp.kernel.fused, and of packing.";
    nb::enum_<Blending>(module, "Blending")
        .value("HUE_PRESERVING", Blending::kHuePreserving)
        .value("TRADITIONAL", Blending::kTraditional)
        .value("FOREMOST", Blending::kForemost)
        .value("WOVEN", Blending::kWoven);
    nb::enum_<Strength>(module, "Strength")
        .value("PERCEIVED", Strength::kPerceived)
        .value("COVERAGE", Strength::kCoverage);
    nb::enum_<Pattern>(module, "Pattern")
        .value("STRIPES", Pattern::kStripes)
        .value("NOISE", Pattern::kNoise);
    nb::enum_<Order>(module, "Order")
        .value("BOTTOM_UP", Order::kBottomUp)
        .value("FRONT_TO_BACK", Order::kFrontToBack)
        .value("PERMUTATION", Order::kPermutation)
        .value("BALANCED", Order::kBalanced)
        .value("SIMULTANEOUS", Order::kSimultaneous)
        .value("WOVEN", Order::kWoven);
    nb::enum_<Factor>(module, "Factor")
        .value("ZERO", Factor::kZero)
        .value("ONE", Factor::kOne)
        .value("ALPHA", Factor::kAlpha)
        .value("REST", Factor::kRest);
    module.def("levels", [] {
        std::vector<std::string> names;
        for (const Level &level : levels()) names.push_back(level.name);
        return names;
    });
    // Arrays and enums are taken as they are or refused: a converted copy of an array would be slow, or
    // lose a result, and a number is no choice.
    module.def("scratch_bytes", [](Order order, int layers) {
        return int64_t(sizeof(float)) * scratch_floats(order, layers, layers);
    }, nb::kw_only(), "order"_a.noconvert(), "layers"_a);
    module.def("run_bytes", [](int64_t terms) {
        return int64_t(sizeof(double)) * run_doubles(terms);
    }, nb::kw_only(), "terms"_a);

    nb::class_<StripLayer>(module, "Layer");
    module.def("layer", &make_layer, nb::kw_only(), "samples"_a.noconvert(), "decode"_a.none().noconvert(),
               "alpha_straight"_a, "matrix"_a.none(), "left"_a, "top"_a, "opacity"_a,
               "factor_a"_a.noconvert(), "factor_b"_a.noconvert(), "behind"_a, "zero_nonfinite"_a);

    nb::class_<SpaceMaps>(module, "SpaceMaps");
    module.def("linear_maps", &make_linear, nb::kw_only(), "weight_red"_a, "weight_blue"_a, "to_p"_a,
               "from_p"_a);
    module.def("hsl_maps", &make_hsl, nb::kw_only(), "weight_red"_a, "weight_blue"_a, "to_p"_a,
               "from_p"_a);
    module.def("oklab_maps", &make_oklab, nb::kw_only(), "weight_red"_a, "weight_blue"_a, "to_lms"_a,
               "to_lab"_a, "to_roots"_a, "from_lms"_a, "inverse_largest"_a, "slack_lo"_a, "slack_hi"_a);
    module.def("cielab_maps", &make_cielab, nb::kw_only(), "weight_red"_a, "weight_blue"_a, "to_xz"_a,
               "from_xz"_a, "inverse_largest"_a, "slack_lo"_a, "slack_hi"_a);
    nb::class_<Background>(module, "Background");
    module.def("background", &make_background, nb::kw_only(), "luminance"_a, "p"_a, "rgb"_a, "lo"_a,
               "hi"_a, "strength"_a);
    nb::class_<Competition>(module, "Competition");
    module.def("competition", &make_competition, nb::kw_only(), "strength"_a.noconvert(), "oklab"_a,
               "half_chroma"_a);
    nb::class_<WeaveTile>(module, "Weave");
    module.def("weave", &make_weave, nb::kw_only(), "pattern"_a.noconvert(), "size"_a,
               "tile"_a.none().noconvert());
    nb::class_<StackRules>(module, "Rules");
    module.def("rules", &make_rules, nb::kw_only(), "blending"_a.noconvert(), "hue_tolerance"_a,
               "rounding_angle"_a, "gray_bias"_a, "order"_a.noconvert(), "permutation"_a, "layers"_a,
               "background"_a.none(), "gain"_a, "space"_a, "competition"_a.none(), "weave"_a.none());

    nb::class_<CodeTables>(module, "Codes");
    module.def("codes", &make_codes, nb::kw_only(), "thresholds"_a.noconvert(), "first_code"_a.noconvert(),
               "bucket_bits"_a, "smallest"_a, "lowest"_a, "darkest"_a, "highest"_a, "matrix"_a.none(),
               "luminance_weights"_a, "space"_a);
    nb::class_<Losses>(module, "Losses")
        .def_ro("out_of_gamut", &Losses::out_of_gamut)
        .def_ro("light_without_alpha", &Losses::light_without_alpha)
        .def_ro("not_a_number", &Losses::not_a_number)
        .def_ro("beyond_half", &Losses::beyond_half);
    nb::class_<Accumulator>(module, "Accumulator")
        .def(nb::init<std::shared_ptr<StackRules>, int64_t, int64_t, int64_t, int64_t,
                      const std::optional<Phases> &, const std::string &>(),
             nb::kw_only(), "rules"_a, "width"_a, "height"_a, "left"_a, "top"_a, "phases"_a.noconvert().none(),
             "level"_a = "")
        .def("add", &Accumulator::add, nb::kw_only(), "numbers"_a, "layers"_a)
        .def("result", &Accumulator::result, nb::kw_only(), "out"_a.noconvert(), "codes"_a.none(),
             "measures"_a.none() = nb::none());

    nb::class_<ProvenancePlanes>(module, "Provenance");
    module.def("provenance", [](Numbers layer, Values grey, Values margin) {
        return ProvenancePlanes{std::move(layer), std::move(grey), std::move(margin)};
    }, nb::kw_only(), "layer"_a.noconvert(), "grey"_a.noconvert(), "margin"_a.noconvert());
    nb::class_<HueSums>(module, "HueSums")
        .def_prop_ro("count", &column_of<&HueSums::count>)
        .def_prop_ro("chroma", &column_of<&HueSums::chroma>)
        .def_prop_ro("alpha", &column_of<&HueSums::alpha>)
        .def_prop_ro("rgb", &rgb_of)
        .def_prop_ro("grey", [](const HueSums &of) { return of.others.grey; })
        .def_prop_ro("transparent", [](const HueSums &of) { return of.others.transparent; })
        .def_prop_ro("nonfinite", [](const HueSums &of) { return of.others.nonfinite; });
    nb::class_<ContributorSums>(module, "ContributorSums")
        .def_ro("pixels", &ContributorSums::pixels)
        .def_ro("survived", &ContributorSums::survived)
        .def_ro("visible", &ContributorSums::visible)
        .def_ro("chroma", &ContributorSums::chroma)
        .def_ro("kept", &ContributorSums::kept);
    nb::class_<ResultFound>(module, "ResultSums")
        .def_prop_ro("chromatic", [](const ResultFound &of) { return of.sums.chromatic; })
        .def_prop_ro("chroma", [](const ResultFound &of) { return of.sums.chroma; })
        .def_prop_ro("foreign", [](const ResultFound &of) { return of.sums.foreign; })
        .def_prop_ro("foreign_chroma", [](const ResultFound &of) { return of.sums.foreign_chroma; })
        .def_prop_ro("light", [](const ResultFound &of) {
            return std::make_tuple(of.sums.light[0], of.sums.light[1], of.sums.light[2]);
        })
        .def_prop_ro("layers", [](const ResultFound &of) {
            return std::vector<ContributorSums>(of.contributors.begin(), of.contributors.end() - 1);
        })
        .def_prop_ro("background", [](const ResultFound &of) { return of.contributors.back(); });
    nb::class_<StripMeasures>(module, "Measures")
        .def_prop_ro("unmeasured", [](const StripMeasures &of) { return of.found.unmeasured; })
        .def_prop_ro("order_sensitive", [](const StripMeasures &of) { return of.found.order_sensitive; })
        .def_prop_ro("result", &found_of<kAsBlended>)
        .def_prop_ro("traditional", &found_of<kTraditional>)
        .def("layer_hues", &hues_of_layer, nb::kw_only(), "number"_a)
        .def_prop_ro("result_hues", &hues_of_result<kAsBlended>)
        .def_prop_ro("traditional_hues", &hues_of_result<kTraditional>)
        .def("layer_squares", &squares_of_layer, nb::kw_only(), "number"_a)
        .def("result_squares", &squares_of_result<kAsBlended>)
        .def("traditional_squares", &squares_of_result<kTraditional>);
    module.def("measures", &make_measures, nb::kw_only(), "layers"_a, "width"_a, "height"_a, "left"_a,
               "top"_a, "bins"_a, "half_step"_a, "achromatic"_a, "foreign_sine"_a, "foreign_cosine"_a,
               "depends_on_order"_a, "provenance"_a.none(), "square_scale"_a = 0, "square_top"_a = 0);
    module.def("keep_runs", &keep_runs, nb::kw_only(), "rules"_a, "counts"_a.noconvert(), "p"_a.noconvert(),
               "strengths"_a.none().noconvert(), "kept"_a.noconvert());
    module.def("measure", &measure, nb::kw_only(), "rules"_a, "layers"_a, "measures"_a, "level"_a = "");
    bind_packing(module);
}

}  // namespace hpcomp
