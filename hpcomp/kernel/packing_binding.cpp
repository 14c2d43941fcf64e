// The binding of the loops on packed bytes: sizes and offsets are checked here.

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <vector>

#include "binding.h"
#include "levels.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace hpcomp {
namespace {

using Bytes = nb::ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using RowsOut = nb::ndarray<uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using BytesOut = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Pixels = nb::ndarray<nb::ro, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using PixelsOut = nb::ndarray<nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// More than any picture has, and far from where products of sizes overflow.
constexpr int64_t kLargest = int64_t(1) << 40;

// Units of 16 bits of a sample: halves and floats alone.
int units_of(nb::dlpack::dtype type) {
    if (is_half(type)) return 1;
    if (type == nb::dtype<float>()) return 2;
    throw nb::type_error("samples must be float16 or float32");
}

void exr_unpack(Bytes block, bool packed, int64_t row_units, const std::vector<int64_t> &channels,
                int64_t first_row, PixelsOut out, const std::string &level) {
    const Packing &packing = *level_of(level).packing;
    const int units = units_of(out.dtype());
    const int64_t rows = int64_t(out.shape(0)), width = int64_t(out.shape(1));
    const int64_t bytes = int64_t(block.size());
    check_aligned(out.data(), 2 * units);
    if (row_units < 1 || row_units > kLargest || bytes % (2 * row_units) != 0)
        throw nb::value_error("a block is whole rows");
    if (first_row < 0 || first_row > kLargest || first_row + rows > bytes / (2 * row_units))
        throw nb::value_error("rows outside the block");
    if (channels.size() != size_t(out.shape(2))) throw nb::value_error("a place for each channel");
    for (const int64_t begin : channels)
        if (begin < 0 || begin > kLargest || begin + width * units > row_units)
            throw nb::value_error("a channel outside its row");
    if (out.size() == 0) return;
    const PlanarRows of{row_units, channels.data(), int(channels.size()), units, width};
    const nb::gil_scoped_release unlocked;
    if (!packed) {
        check_aligned(block.data(), 2);
        const auto *planar = reinterpret_cast<const uint16_t *>(block.data());
        packing.interleave(of, planar + first_row * row_units, rows,
                           static_cast<uint16_t *>(out.data()));
        return;
    }
    static thread_local std::vector<uint8_t> split;
    static thread_local std::vector<uint16_t> merged;
    split.resize(size_t(bytes));
    merged.resize(size_t(bytes / 2));
    packing.merge(block.data(), bytes, split.data(), merged.data());
    packing.interleave(of, merged.data() + first_row * row_units, rows,
                       static_cast<uint16_t *>(out.data()));
}

void exr_pack(Pixels samples, BytesOut out, const std::string &level) {
    const Packing &packing = *level_of(level).packing;
    const int units = units_of(samples.dtype());
    check_aligned(samples.data(), 2 * units);
    if (samples.shape(2) > 1024) throw nb::value_error("samples must have no more than 1024 channels");
    const size_t bytes = samples.size() * 2 * size_t(units);
    if (out.size() != bytes) throw nb::value_error("out must have a byte for each of the samples");
    if (bytes == 0) return;
    const nb::gil_scoped_release unlocked;
    static thread_local std::vector<uint8_t> split;
    split.resize(bytes);
    packing.pack(static_cast<const uint16_t *>(samples.data()), int(samples.shape(2)), units,
                 int64_t(samples.shape(1)), int64_t(samples.shape(0)), split.data(), out.data());
}

void check_pixel_bytes(int pixel_bytes, int64_t row_bytes) {
    for (const int valid : {1, 2, 3, 4, 6, 8})
        if (pixel_bytes == valid && row_bytes % pixel_bytes == 0) return;
    throw nb::value_error("pixels must have 1, 2, 3, 4, 6 or 8 bytes, and rows whole pixels");
}

void png_unfilter(Rows filtered, int pixel_bytes, Bytes above, RowsOut out,
                  const std::string &level) {
    const Packing &packing = *level_of(level).packing;
    const int64_t rows = int64_t(out.shape(0)), row_bytes = int64_t(out.shape(1));
    check_pixel_bytes(pixel_bytes, row_bytes);
    if (int64_t(filtered.shape(0)) != rows || int64_t(filtered.shape(1)) != row_bytes + 1)
        throw nb::value_error("filtered rows must have one byte more");
    if (int64_t(above.size()) != row_bytes) throw nb::value_error("the row above must be as long");
    bool known = false;
    {
        const nb::gil_scoped_release unlocked;
        known = packing.unfilter(filtered.data(), rows, row_bytes, pixel_bytes, above.data(),
                                 out.data());
    }
    if (!known) throw nb::value_error("a filter that PNG does not know");
}

void png_filter(Rows rows, int pixel_bytes, RowsOut out, const std::string &level) {
    const Packing &packing = *level_of(level).packing;
    const int64_t count = int64_t(rows.shape(0)), row_bytes = int64_t(rows.shape(1));
    check_pixel_bytes(pixel_bytes, row_bytes);
    if (row_bytes < pixel_bytes) throw nb::value_error("a row needs pixels");
    if (int64_t(out.shape(0)) != count || int64_t(out.shape(1)) != row_bytes + 1)
        throw nb::value_error("filtered rows must have one byte more");
    const nb::gil_scoped_release unlocked;
    packing.filter(rows.data(), count, row_bytes, pixel_bytes, out.data());
}

}  // namespace

void bind_packing(nb::module_ &kernel) {
    nb::module_ module = kernel.def_submodule("packing", "Samples to what codecs deflate, and back.");
    module.def("exr_unpack", &exr_unpack, nb::kw_only(), "block"_a.noconvert(), "packed"_a, "row_units"_a,
               "channels"_a, "first_row"_a, "out"_a.noconvert(), "level"_a = "");
    module.def("exr_pack", &exr_pack, nb::kw_only(), "samples"_a.noconvert(), "out"_a.noconvert(),
               "level"_a = "");
    module.def("png_unfilter", &png_unfilter, nb::kw_only(), "filtered"_a.noconvert(), "pixel_bytes"_a,
               "above"_a.noconvert(), "out"_a.noconvert(), "level"_a = "");
    module.def("png_filter", &png_filter, nb::kw_only(), "rows"_a.noconvert(), "pixel_bytes"_a,
               "out"_a.noconvert(), "level"_a = "");
}

}  // namespace hpcomp
