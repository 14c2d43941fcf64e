// The door between Python and the loops: every array, size and number is checked here, so that the
// loops need not. Nothing is computed on pixels.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <initializer_list>
#include <limits>
#include <memory>
#include <stdexcept>
#include <type_traits>

#include "door.h"
#include "levels.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace hpcomp {

namespace {

// Pixels of a band: its planes stay in the L2 cache beside the samples.
constexpr int kBandPixels = 1 << 12;

// Far below where sums of coordinates leave an int.
constexpr int64_t kFarthest = int64_t(1) << 29;

int checked_coordinate(int64_t value) {
    if (value < -kFarthest || value > kFarthest) throw nb::value_error("coordinate out of range");
    return int(value);
}

using AnyArray = nb::ndarray<nb::ro, nb::device::cpu>;
using Table = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using CodeTable = nb::ndarray<const uint16_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

Sample sample_of(nb::dlpack::dtype type) {
    if (type == nb::dtype<uint8_t>()) return Sample::kU8;
    if (type == nb::dtype<uint16_t>()) return Sample::kU16;
    if (type == nb::dtype<float>()) return Sample::kFloat;
    if (is_half(type)) return Sample::kHalf;
    throw nb::type_error("samples must be uint8, uint16, float16 or float32");
}

Factor factor_of(int value) {
    if (value < 0 || value > int(Factor::kRest)) throw nb::value_error("unknown factor");
    return Factor(value);
}

// A layer's strip, and what keeps its arrays alive.
struct StripLayer {
    Layer layer{};
    AnyArray samples;
    Table decode;
};

StripLayer make_layer(AnyArray samples, std::optional<Table> decode, bool alpha_straight,
                      std::optional<std::array<float, 9>> matrix, int64_t left, int64_t top,
                      float opacity, int factor_a, int factor_b, bool behind, bool zero_nonfinite) {
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
    if (matrix)
        for (int i = 0; i < 9; ++i) layer.matrix[i] = (*matrix)[i];
    layer.left = checked_coordinate(left);
    layer.top = checked_coordinate(top);
    layer.width = checked_coordinate(width);
    layer.height = checked_coordinate(height);
    if (!(opacity >= 0 && opacity <= 1)) throw nb::value_error("opacity must be from 0 to 1");
    layer.opacity = opacity;
    layer.factor_a = factor_of(factor_a);
    layer.factor_b = factor_of(factor_b);
    layer.behind = behind;
    layer.zero_nonfinite = zero_nonfinite;
    made.samples = std::move(samples);
    return made;
}

// Rules with the permutation that they point to.
struct StackRules {
    Rules rules{};
    std::vector<int> permutation;
};

std::shared_ptr<StackRules> make_rules(int blending, float tolerance, float rounding_angle,
                                       float gray_bias, int order, std::vector<int> permutation, int layers,
                                       std::optional<std::array<float, 3>> background, float gain,
                                       std::array<float, 2> weights, std::array<float, 4> to_p,
                                       std::array<float, 6> from_p, int maps,
                                       const std::vector<float> &numbers,
                                       std::array<float, 2> background_bounds) {
    auto made = std::make_shared<StackRules>();
    Rules &rules = made->rules;
    if (layers < 1 || layers > (1 << 20)) throw nb::value_error("a stack needs layers");
    if (order < 0 || order > int(Order::kSimultaneous)) throw nb::value_error("unknown order");
    if (blending < 0 || blending > int(Blending::kForemost)) throw nb::value_error("unknown blending");
    // The folds of other orders do not know who is in front.
    if (Blending(blending) == Blending::kForemost && Order(order) != Order::kBottomUp)
        throw nb::value_error("the foremost is found from the bottom up");
    if (!(gray_bias >= 0 && gray_bias <= 1)) throw nb::value_error("gray bias must be from 0 to 1");
    if (Order(order) == Order::kPermutation) {
        std::vector<bool> seen(size_t(layers), false);
        if (permutation.size() != size_t(layers)) throw nb::value_error("not a permutation");
        for (const int number : permutation) {
            if (number < 0 || number >= layers || seen[size_t(number)])
                throw nb::value_error("not a permutation");
            seen[size_t(number)] = true;
        }
    }
    made->permutation = std::move(permutation);
    rules.blending = Blending(blending);
    rules.gray_power = 3 * gray_bias;
    // Without a tolerance the switch is hard, at what float rounding turns a vector by.
    rules.tolerance = tolerance > 0 ? tolerance : rounding_angle;
    rules.inverse_tolerance = tolerance > 0 ? 1 / tolerance : 0;
    const float end = tolerance > 0 ? std::min(2 * tolerance, 3.14159265f) : rules.tolerance;
    rules.end_sine = std::sin(end);
    rules.end_cosine = std::cos(end);
    rules.order = Order(order);
    rules.permutation = made->permutation.data();
    rules.layers = layers;
    rules.has_background = background.has_value();
    if (background) {
        rules.background_luminance = (*background)[0];
        rules.background_p[0] = (*background)[1];
        rules.background_p[1] = (*background)[2];
    }
    rules.gain = gain;
    rules.weight_red = weights[0];
    rules.weight_blue = weights[1];
    for (int i = 0; i < 4; ++i) rules.to_p[i / 2][i % 2] = to_p[size_t(i)];
    for (int i = 0; i < 6; ++i) rules.from_p[i / 2][i % 2] = from_p[size_t(i)];
    if (maps < 0 || maps > int(Maps::kCielab)) throw nb::value_error("unknown maps");
    rules.maps = Maps(maps);
    for (int i = 0; i < 2; ++i) rules.background_bounds[i] = background_bounds[size_t(i)];
    // Structures of floats alone, in the sequence of their fields; the last is an inverse.
    static_assert(sizeof(OklabNumbers) == 25 * sizeof(float) && sizeof(CielabNumbers) == 11 * sizeof(float));
    const size_t needed = rules.maps == Maps::kOklab ? 25 : rules.maps == Maps::kCielab ? 11 : 0;
    if (numbers.size() != needed) throw nb::value_error("other numbers belong to these maps");
    if (needed && !(numbers.back() > 0)) throw nb::value_error("the bound of |p|/Y must be positive");
    if (rules.maps == Maps::kOklab) std::memcpy(&rules.oklab, numbers.data(), sizeof rules.oklab);
    if (rules.maps == Maps::kCielab) std::memcpy(&rules.cielab, numbers.data(), sizeof rules.cielab);
    return made;
}

using Sums = nb::ndarray<int64_t, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<uint32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Values = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

template <class Array>
auto *checked_values(const std::optional<Array> &array, int64_t height, int64_t width) {
    using Value = std::remove_pointer_t<decltype(array->data())>;
    if (!array) return static_cast<Value *>(nullptr);
    if (int64_t(array->shape(0)) != height || int64_t(array->shape(1)) != width)
        throw nb::value_error("provenance must be height x width");
    check_aligned(array->data(), sizeof(Value));
    return array->data();
}

void check_sums(const Sums &sums, std::initializer_list<int64_t> shape) {
    size_t axis = 0;
    bool fits = sums.ndim() == shape.size();
    for (const int64_t size : shape) {
        fits = fits && int64_t(sums.shape(axis)) == size;
        ++axis;
    }
    if (!fits) throw nb::value_error("sums of another shape are needed");
    check_aligned(sums.data(), sizeof(int64_t));
}

// The sums that the measures of a strip are added to, see `measure.h`, and its planes of provenance.
struct StripMeasures {
    MeasureRules rules{};
    Measures found{};
    int64_t layers, width, height;
    Sums results, hues, others;
    std::optional<Numbers> layer;
    std::optional<Values> grey, margin;
};

std::unique_ptr<StripMeasures> make_measures(std::array<float, 4> limits, bool depends_on_order,
                                             int64_t layers, int64_t width, int64_t height, Sums results,
                                             Sums hues, Sums others, std::optional<Numbers> layer,
                                             std::optional<Values> grey, std::optional<Values> margin) {
    if (layers < 1 || layers > (1 << 20)) throw nb::value_error("a stack needs layers");
    if (width < 1 || height < 1) throw nb::value_error("a strip needs pixels");
    const int64_t bins = hues.ndim() == 3 ? int64_t(hues.shape(1)) : 0;
    if (bins < 1 || bins > (1 << 16)) throw nb::value_error("hues need bins");
    check_sums(results, {kResults, kResultSums + kContributorSums * (layers + 1)});
    check_sums(hues, {layers + kResults, bins, kHueColumns});
    check_sums(others, {layers + kResults, kOthers});
    const bool wanted = layer.has_value();
    if (wanted != grey.has_value() || wanted != margin.has_value())
        throw nb::value_error("provenance is three arrays or none");
    auto made = std::make_unique<StripMeasures>();
    made->found.results = results.data();
    made->found.hues = hues.data();
    made->found.others = others.data();
    made->found.provenance = {checked_values(layer, height, width), checked_values(grey, height, width),
                              checked_values(margin, height, width)};
    made->rules = {limits[0], limits[1], limits[2], limits[3], depends_on_order, int(bins)};
    made->layers = layers, made->width = width, made->height = height;
    made->results = std::move(results), made->hues = std::move(hues), made->others = std::move(others);
    made->layer = std::move(layer), made->grey = std::move(grey), made->margin = std::move(margin);
    return made;
}

class Accumulator {
  public:
    Accumulator(std::shared_ptr<StackRules> rules, int64_t width, int64_t height,
                const std::string &level)
        : rules_(std::move(rules)), level_(level_of(level)), engine_(level_.engine),
          width_(checked_coordinate(width)), height_(checked_coordinate(height)) {
        if (width < 1 || height < 1) throw nb::value_error("a strip needs pixels");
    }

    // Takes layers in their turn. Returns how many pixels of each are NaN or infinite; where layers
    // wait for all the others, `result` tells.
    std::vector<int64_t> add(const std::vector<int> &numbers, std::vector<StripLayer *> strips) {
        if (numbers.size() != strips.size()) throw nb::value_error("a number for each layer");
        for (const StripLayer *strip : strips)
            if (strip == nullptr) throw nb::type_error("layers must be made by `layer`");
        const int layers_in_all = rules_->rules.layers;
        if (numbers.size() > size_t(layers_in_all - come_)) throw nb::value_error("too many layers");
        const bool from_front = rules_->rules.order == Order::kFrontToBack;
        for (size_t i = 0; i < numbers.size(); ++i) {
            const int turn = come_ + int(i);
            if (numbers[i] != (from_front ? layers_in_all - 1 - turn : turn))
                throw nb::value_error("layers out of order");
        }
        come_ += int(numbers.size());
        std::vector<int64_t> nonfinite(numbers.size(), 0);
        waits_ = !folds() || int(numbers.size()) == layers_in_all;
        if (!waits_) {
            if (planes_.empty()) begin_planes(height_);
            // Copies, which keep the arrays alive while other threads run.
            std::vector<StripLayer> taken;
            for (const StripLayer *strip : strips) taken.push_back(*strip);
            std::vector<Layer> layers;
            for (const StripLayer &strip : taken) layers.push_back(strip.layer);
            nb::gil_scoped_release unlocked;
            engine_->add(rules_->rules, layers.data(), numbers.data(), int(numbers.size()), width_,
                         height_, state_, nonfinite.data(), nullptr);
        } else {
            for (const StripLayer *strip : strips) held_.push_back(*strip);
        }
        return nonfinite;
    }

    // Writes the strip to `out`, and measures it if all layers came at once; returns the counts of
    // `Losses`, and of the layers as `add` does.
    std::pair<std::vector<int64_t>, std::vector<int64_t>>
    result(nb::ndarray<nb::device::cpu, nb::c_contig> out, std::optional<Table> thresholds,
           std::optional<CodeTable> first_code, int bucket_bits, std::array<float, 4> limits,
           std::optional<std::array<float, 9>> matrix, std::array<double, 3> weights,
           StripMeasures *measures) {
        if (out.ndim() != 3 || int64_t(out.shape(0)) != height_ || int64_t(out.shape(1)) != width_ ||
            out.shape(2) != 4)
            throw nb::value_error("out must be height x width x 4");
        check_aligned(out.data(), out.dtype().bits / 8);
        check_finished(measures);
        Output output{};
        output.samples = out.data();
        output.type = sample_of(out.dtype());
        if (output.type == Sample::kU8 || output.type == Sample::kU16)
            check_codes(output, thresholds, first_code, bucket_bits, limits);
        output.has_matrix = matrix.has_value();
        if (matrix) std::copy(matrix->begin(), matrix->end(), output.matrix);
        std::copy(weights.begin(), weights.end(), output.weights);
        finished_ = true;
        const std::vector<StripLayer> held = std::move(held_);
        std::vector<int64_t> nonfinite(held.size(), 0);
        Losses losses{};
        std::vector<Layer> layers;
        for (const StripLayer &strip : held) layers.push_back(strip.layer);
        {
            const nb::gil_scoped_release unlocked;
            if (waits_)
                reduce_in_bands(std::move(layers), &output, int64_t(out.dtype().bits / 8), &losses,
                                nonfinite.data(), measures);
            else
                engine_->finish(rules_->rules, int64_t(height_) * width_, state_, output, &losses);
        }
        return {{losses.out_of_gamut, losses.light_without_alpha, losses.not_a_number,
                 losses.beyond_half},
                nonfinite};
    }

    // Measures the strip alone.
    void measure(StripMeasures &measures) {
        check_finished(&measures);
        finished_ = true;
        const std::vector<StripLayer> held = std::move(held_);
        std::vector<int64_t> nonfinite(held.size(), 0);
        std::vector<Layer> layers;
        for (const StripLayer &strip : held) layers.push_back(strip.layer);
        const nb::gil_scoped_release unlocked;
        reduce_in_bands(std::move(layers), nullptr, 0, nullptr, nonfinite.data(), &measures);
    }

  private:
    void check_finished(const StripMeasures *measures) const {
        if (come_ != rules_->rules.layers) throw nb::value_error("not all layers have come");
        if (finished_) throw nb::value_error("the result has been taken");
        if (measures == nullptr) return;
        if (!waits_) throw nb::value_error("layers are measured when all come at once");
        if (rules_->rules.maps != Maps::kLinear) throw nb::value_error("linear spaces alone are measured");
        if (measures->layers != come_ || measures->width != width_ || measures->height != height_)
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
        const bool bounded = rules_->rules.maps != Maps::kLinear;
        const int count = 4 + (front ? 1 : 0) + (bounded ? 2 : 0);
        if (planes_.empty()) planes_.resize(size_t(pixels) * size_t(count));
        float *plane = planes_.data(), *last = plane + count * pixels;
        state_ = {plane, plane + pixels, plane + 2 * pixels, plane + 3 * pixels,
                  front ? plane + 4 * pixels : nullptr, bounded ? last - 2 * pixels : nullptr,
                  bounded ? last - pixels : nullptr};
        if (!front) return;
        std::fill(plane, last, 0.0f);
        std::fill(plane + 4 * pixels, plane + 5 * pixels, 1.0f);
    }

    // All layers, from samples to samples in bands whose planes stay in cache. Without an output the
    // layers are measured alone.
    void reduce_in_bands(std::vector<Layer> layers, const Output *output, int64_t sample_bytes,
                         Losses *losses, int64_t *nonfinite, StripMeasures *measures) {
        const Rules &rules = rules_->rules;
        const int n = int(layers.size());
        std::vector<int> numbers(layers.size());
        std::vector<Layer> by_number(layers);
        for (int i = 0; i < n; ++i)
            numbers[size_t(i)] = rules.order == Order::kFrontToBack ? n - 1 - i : i;
        for (int i = 0; i < n; ++i) by_number[size_t(numbers[size_t(i)])] = layers[size_t(i)];
        std::vector<float> scratch(folds() ? 0 : size_t(scratch_floats(rules.order, n)));
        std::vector<float> measuring(measures ? size_t(measure_floats(rules.order, n)) : 0);
        Measurer measurer{};
        if (measures)
            measurer = {&rules, &measures->rules, by_number.data(), n, width_, 0, measuring.data(),
                        &measures->found};
        const Observer watching{&measurer, level_.measuring->term, level_.measuring->block};
        const Observer *observer = measures ? &watching : nullptr;
        const int band = std::max(1, kBandPixels / width_);
        for (int y = 0; y < height_; y += band) {
            const int rows = std::min(band, height_ - y);
            begin_planes(rows);
            measurer.top = y;
            if (folds())
                engine_->add(rules, layers.data(), numbers.data(), n, width_, rows, state_, nonfinite,
                             observer);
            else
                engine_->reduce(rules, layers.data(), n, width_, rows, state_, scratch.data(), nonfinite,
                                observer);
            if (output) {
                Output part = *output;
                part.samples = static_cast<char *>(output->samples) + 4 * sample_bytes * width_ * y;
                engine_->finish(rules, int64_t(rows) * width_, state_, part, losses);
            }
            for (Layer &layer : layers) layer.top -= rows;
        }
    }

    static void check_codes(Output &output, const std::optional<Table> &thresholds,
                            const std::optional<CodeTable> &first_code, int bucket_bits,
                            const std::array<float, 4> &limits) {
        const size_t codes = output.type == Sample::kU8 ? 256 : 65536;
        if (!thresholds || thresholds->shape(0) != codes)
            throw nb::value_error("integer output needs a threshold for each code");
        check_aligned(thresholds->data(), sizeof(float));
        // The last one is infinite: no value passes it, and no code beyond it exists.
        for (size_t i = 0; i < codes; ++i)
            if (!(thresholds->data()[i] > (i ? thresholds->data()[i - 1] : 0.0f)))
                throw nb::value_error("thresholds must increase");
        if (thresholds->data()[codes - 1] != std::numeric_limits<float>::infinity())
            throw nb::value_error("the last threshold must be infinite");
        if (bucket_bits < 1 || bucket_bits > 16) throw nb::value_error("bucket_bits out of range");
        const float smallest = limits[3];
        int octaves = 0;
        for (float edge = smallest; edge > 0 && edge < 1 && octaves < 64; edge *= 2) ++octaves;
        if (!(smallest > 0) || octaves < 1 || octaves >= 64 ||
            std::ldexp(1.0f, -octaves) != smallest)
            throw nb::value_error("buckets must begin at a power of two below 1");
        if (!first_code || first_code->shape(0) != (size_t(octaves) << bucket_bits) + 1)
            throw nb::value_error("a first code for each bucket is needed");
        check_aligned(first_code->data(), sizeof(uint16_t));
        for (size_t i = 0; i < first_code->shape(0); ++i)
            if (first_code->data()[i] >= codes) throw nb::value_error("a first code out of range");
        output.thresholds = thresholds->data();
        output.first_code = first_code->data();
        output.bucket_bits = bucket_bits;
        output.lowest = limits[0];
        output.darkest = limits[1];
        output.highest = limits[2];
        output.smallest = smallest;
    }

    std::shared_ptr<StackRules> rules_;
    const Level &level_;
    const Engine *engine_;
    int width_, height_;
    std::vector<float> planes_;
    State state_{};
    std::vector<StripLayer> held_;
    int come_ = 0;  // how many layers have
    bool waits_ = true;     // for all layers, which are held until then
    bool finished_ = false;
};

// Measures all layers of a strip without compositing it.
void measure(std::shared_ptr<StackRules> rules, const std::vector<StripLayer *> &strips,
             StripMeasures &measures, const std::string &level) {
    const int layers = int(strips.size());
    Accumulator strip(rules, measures.width, measures.height, level);
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
    module.doc() = "The fused engine's loops; hpcomp.kernel is its face.";
    nb::class_<StripLayer>(module, "Layer");
    nb::class_<StackRules>(module, "Rules");
    module.def("levels", [] {
        std::vector<std::string> names;
        for (const Level &level : levels()) names.push_back(level.name);
        return names;
    });
    // Arrays are taken as they are or refused: a converted copy would be slow, or lose a result.
    module.def("scratch_bytes", [](int order, int layers) {
        return int64_t(sizeof(float)) * scratch_floats(Order(order), layers);
    }, "order"_a, "layers"_a);
    module.def("layer", &make_layer, "samples"_a.noconvert(), "decode"_a.none().noconvert(), "alpha_straight"_a,
               "matrix"_a.none(), "left"_a, "top"_a, "opacity"_a, "factor_a"_a, "factor_b"_a,
               "behind"_a, "zero_nonfinite"_a);
    module.def("rules", &make_rules, "blending"_a, "tolerance"_a, "rounding_angle"_a, "gray_bias"_a,
               "order"_a, "permutation"_a, "layers"_a, "background"_a.none(), "gain"_a, "weights"_a, "to_p"_a, "from_p"_a,
               "maps"_a = 0, "numbers"_a = std::vector<float>{},
               "background_bounds"_a = std::array<float, 2>{});
    nb::class_<Accumulator>(module, "Accumulator")
        .def(nb::init<std::shared_ptr<StackRules>, int64_t, int64_t, const std::string &>(), "rules"_a,
             "width"_a, "height"_a, "level"_a = "")
        .def("add", &Accumulator::add, "numbers"_a, "layers"_a)
        .def("result", &Accumulator::result, "out"_a.noconvert(), "thresholds"_a.none().noconvert(),
             "first_code"_a.none().noconvert(),
             "bucket_bits"_a, "limits"_a, "matrix"_a.none(), "weights"_a, "measures"_a.none() = nb::none());
    nb::class_<StripMeasures>(module, "Measures")
        .def_prop_ro("unmeasured", [](const StripMeasures &of) { return of.found.unmeasured; })
        .def_prop_ro("order_sensitive", [](const StripMeasures &of) { return of.found.order_sensitive; });
    module.def("measures", &make_measures, "limits"_a, "depends_on_order"_a, "layers"_a, "width"_a,
               "height"_a, "results"_a.noconvert(), "hues"_a.noconvert(), "others"_a.noconvert(),
               "layer"_a.none().noconvert(), "grey"_a.none().noconvert(),
               "margin"_a.none().noconvert());
    module.def("measure", &measure, "rules"_a, "layers"_a, "measures"_a, "level"_a = "");
    bind_packing(module);
}

}  // namespace hpcomp
