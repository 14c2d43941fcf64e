#include "packing.h"

#include <cstring>
#include <type_traits>
#include <utility>
#include <vector>

#ifdef __SSE2__
#include <emmintrin.h>
#endif

#ifndef HPCOMP_LEVEL
#error "compile with -DHPCOMP_LEVEL=<name of this instruction set's packing>"
#endif

namespace hpcomp {
namespace {

constexpr uint64_t kEvenBytes = 0x00ff00ff00ff00ffu;
constexpr uint64_t kOnes = 0x0001000100010001u;
// EXR's differences are stored with this added.
constexpr uint8_t kBias = 128;

// --- EXR -----------------------------------------------------------------------------------------

// split[i] = the sum of packed[0..i] without their biases, modulo 256.
void undo_differences(const uint8_t *packed, int64_t bytes, uint8_t *split) {
    uint64_t sum = kBias;  // the first byte is stored without a bias
    int64_t i = 0;
#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
    // Eight at a time: sums of pairs of bytes in lanes of 16 bits, which one multiplication adds up.
    for (; i + 8 <= bytes; i += 8) {
        uint64_t differences;
        std::memcpy(&differences, packed + i, 8);
        differences ^= 0x8080808080808080u;  // minus the bias, modulo 256
        const uint64_t odd = (differences >> 8) & kEvenBytes;
        const uint64_t up_to_odd = ((differences & kEvenBytes) + odd) * kOnes;
        const uint64_t before = (sum & 0xffu) * kOnes;
        // Lanes stay below 2^16: four pairs of bytes and what came before.
        const uint64_t at_odd = (up_to_odd + before) & kEvenBytes;
        const uint64_t at_even = (up_to_odd + before + (kOnes << 8) - odd) & kEvenBytes;
        const uint64_t sums = at_even | at_odd << 8;
        std::memcpy(split + i, &sums, 8);
        sum += up_to_odd >> 48;
    }
#endif
    for (; i < bytes; ++i) {
        sum += uint8_t(packed[i] - kBias);
        split[i] = uint8_t(sum);
    }
}

void merge(const uint8_t *packed, int64_t bytes, uint8_t *split, uint16_t *merged) {
    undo_differences(packed, bytes, split);
    const int64_t units = bytes / 2;
    const uint8_t *even = split, *odd = split + units;
    for (int64_t i = 0; i < units; ++i) merged[i] = uint16_t(even[i] | odd[i] << 8);
}

void interleave(const PlanarRows &of, const uint16_t *planar, int64_t rows, uint16_t *out) {
    const int64_t width = of.width, step = int64_t(of.count) * of.units;
    for (int64_t y = 0; y < rows; ++y, planar += of.row_units, out += width * step) {
        if (of.count == 4 && of.units == 1) {
            const uint16_t *a = planar + of.channels[0], *b = planar + of.channels[1];
            const uint16_t *c = planar + of.channels[2], *d = planar + of.channels[3];
            for (int64_t x = 0; x < width; ++x) {
                out[4 * x] = a[x];
                out[4 * x + 1] = b[x];
                out[4 * x + 2] = c[x];
                out[4 * x + 3] = d[x];
            }
            continue;
        }
        for (int k = 0; k < of.count; ++k) {
            const uint16_t *plane = planar + of.channels[k];
            uint16_t *to = out + k * of.units;
            if (of.units == 1)
                for (int64_t x = 0; x < width; ++x) to[x * step] = plane[x];
            else
                for (int64_t x = 0; x < width; ++x) {
                    to[x * step] = plane[2 * x];
                    to[x * step + 1] = plane[2 * x + 1];
                }
        }
    }
}

template <int Channels>
void split_planes(const uint16_t *samples, int channels, int units, int64_t width, int64_t rows,
                  uint8_t *even, uint8_t *odd) {
    // Known to the compiler for the most frequent number, which it then vectorises.
    const int64_t step = (Channels ? Channels : channels) * int64_t(units);
    for (int64_t y = 0; y < rows; ++y) {
        for (int channel = channels - 1; channel >= 0; --channel) {
            const uint16_t *from = samples + y * width * step + channel * units;
            if (units == 1) {
                for (int64_t x = 0; x < width; ++x) {
                    even[x] = uint8_t(from[Channels ? x * Channels : x * step]);
                    odd[x] = uint8_t(from[Channels ? x * Channels : x * step] >> 8);
                }
            } else {
                for (int64_t x = 0; x < width; ++x) {
                    even[2 * x] = uint8_t(from[x * step]);
                    odd[2 * x] = uint8_t(from[x * step] >> 8);
                    even[2 * x + 1] = uint8_t(from[x * step + 1]);
                    odd[2 * x + 1] = uint8_t(from[x * step + 1] >> 8);
                }
            }
            even += width * units, odd += width * units;
        }
    }
}

void pack(const uint16_t *samples, int channels, int units, int64_t width, int64_t rows,
          uint8_t *split, uint8_t *packed) {
    const int64_t all = rows * width * channels * units;
    if (channels == 4)
        split_planes<4>(samples, channels, units, width, rows, split, split + all);
    else
        split_planes<0>(samples, channels, units, width, rows, split, split + all);
    packed[0] = split[0];
    for (int64_t i = 1; i < 2 * all; ++i) packed[i] = uint8_t(split[i] - split[i - 1] + kBias);
}

// --- PNG -----------------------------------------------------------------------------------------

enum Filter : uint8_t { kNone, kSub, kUp, kAverage, kPaeth };

// The bytes of a pixel, eight at most, in lanes of 16 bits whose upper bytes are 0.
typedef int16_t Lanes __attribute__((vector_size(16)));
typedef uint8_t LaneBytes __attribute__((vector_size(16)));
typedef uint8_t HalfBytes __attribute__((vector_size(8)));

// To lanes and back by intrinsics where there are any: of half a register compilers make several.
template <int Count>
inline Lanes lanes_of(const uint8_t *bytes) {
#ifdef __SSE2__
    std::conditional_t<Count <= 4, uint32_t, uint64_t> word = 0;
    std::memcpy(&word, bytes, Count);
    const __m128i packed = Count <= 4 ? _mm_cvtsi32_si128(int(word))
                                      : _mm_loadl_epi64(reinterpret_cast<const __m128i *>(&word));
    return Lanes(_mm_unpacklo_epi8(packed, _mm_setzero_si128()));
#else
    HalfBytes packed = {};
    std::memcpy(&packed, bytes, Count);
    return __builtin_convertvector(packed, Lanes);
#endif
}

template <int Count>
inline void store(Lanes lanes, uint8_t *bytes) {
#ifdef __SSE2__
    const __m128i packed = _mm_packus_epi16(__m128i(lanes), __m128i(lanes));
#else
    const HalfBytes packed = __builtin_convertvector(lanes, HalfBytes);
#endif
    std::memcpy(bytes, &packed, Count);
}

// Sums modulo 256: of bytes, so that nothing is carried into the upper ones.
inline Lanes sum(Lanes a, Lanes b) { return Lanes(LaneBytes(a) + LaneBytes(b)); }

inline Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }
inline Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }

struct None {
    static Lanes pixel(Lanes filtered, Lanes, Lanes, Lanes) { return filtered; }
};

struct Sub {
    static Lanes pixel(Lanes filtered, Lanes left, Lanes, Lanes) { return sum(filtered, left); }
};

struct Up {
    static Lanes pixel(Lanes filtered, Lanes, Lanes up, Lanes) { return sum(filtered, up); }
};

struct Average {
    static Lanes pixel(Lanes filtered, Lanes left, Lanes up, Lanes) {
        return sum(filtered, (left + up) >> 1);
    }
};

// Of left, up and corner the one nearest to left + up - corner, of equal ones the first. That is the
// smaller of left and up where the corner is so large that 3 * corner - left - up is no smaller than
// the larger one, the larger one in the opposite case, and else the corner. What waits for the pixel
// on the left sets the pace, so the filtered byte is added before the choice.
struct Paeth {
    static Lanes pixel(Lanes filtered, Lanes left, Lanes up, Lanes corner) {
        const Lanes opposite = corner + (corner + corner) - up - left;
        const Lanes low = smaller(left, up), high = larger(left, up);
        const Lanes of_low = sum(filtered, low), of_high = sum(filtered, high);
        const Lanes of_corner = sum(filtered, corner);
        const Lanes not_high = high <= opposite ? of_low : of_corner;
        return opposite <= low ? of_high : not_high;
    }
};

// Those of the next pixel; nothing is on the left of a row.
struct Neighbours {
    Lanes left = {}, corner = {};
};

// A pixel, as so many bytes.
template <class Filter, int Count>
inline void unfilter_pixel(const uint8_t *filtered, const uint8_t *above, uint8_t *out, Neighbours &of) {
    const Lanes up = lanes_of<Count>(above);
    of.left = Filter::pixel(lanes_of<Count>(filtered), of.left, up, of.corner);
    of.corner = up;
    store<Count>(of.left, out);
}

template <class Filter, int Bytes>
void unfilter_row(const uint8_t *filtered, int64_t row_bytes, const uint8_t *above, uint8_t *out) {
    // Registers take 4 or 8 bytes at once: what is written behind a pixel is overwritten by the next.
    constexpr int kWide = Bytes <= 4 ? 4 : 8;
    Neighbours of;
    int64_t i = 0;
    for (; i + kWide <= row_bytes; i += Bytes)
        unfilter_pixel<Filter, kWide>(filtered + i, above + i, out + i, of);
    for (; i < row_bytes; i += Bytes)
        unfilter_pixel<Filter, Bytes>(filtered + i, above + i, out + i, of);
}

// Rows whose pixels have so many bytes.
template <int Bytes>
bool unfilter_pixels(const uint8_t *filtered, int64_t rows, int64_t row_bytes, const uint8_t *above,
                     uint8_t *out) {
    for (int64_t y = 0; y < rows; ++y) {
        const uint8_t filter = *filtered++;
        switch (filter) {
        case kNone: std::memmove(out, filtered, size_t(row_bytes)); break;
        case kUp:
            for (int64_t i = 0; i < row_bytes; ++i) out[i] = uint8_t(filtered[i] + above[i]);
            break;
        case kSub: unfilter_row<Sub, Bytes>(filtered, row_bytes, above, out); break;
        case kAverage: unfilter_row<Average, Bytes>(filtered, row_bytes, above, out); break;
        case kPaeth: unfilter_row<Paeth, Bytes>(filtered, row_bytes, above, out); break;
        default: return false;
        }
        filtered += row_bytes;
        above = out;
        out += row_bytes;
    }
    return true;
}

bool unfilter(const uint8_t *filtered, int64_t rows, int64_t row_bytes, int pixel_bytes,
              const uint8_t *above, uint8_t *out) {
    switch (pixel_bytes) {
    case 1: return unfilter_pixels<1>(filtered, rows, row_bytes, above, out);
    case 2: return unfilter_pixels<2>(filtered, rows, row_bytes, above, out);
    case 3: return unfilter_pixels<3>(filtered, rows, row_bytes, above, out);
    case 4: return unfilter_pixels<4>(filtered, rows, row_bytes, above, out);
    case 6: return unfilter_pixels<6>(filtered, rows, row_bytes, above, out);
    case 8: return unfilter_pixels<8>(filtered, rows, row_bytes, above, out);
    default: return false;
    }
}

// The differences of so many bytes to what the filter makes of their neighbours, 0 where they have no
// pixel before them; returns their sizes as signed bytes, 0 to 128.
template <class Filter, int Count>
inline Lanes filter_bytes(const uint8_t *row, const uint8_t *above, int before, uint8_t *differences) {
    const Lanes nothing = {};
    const Lanes left = before ? lanes_of<Count>(row - before) : nothing;
    const Lanes corner = before ? lanes_of<Count>(above - before) : nothing;
    const Lanes predicted = Filter::pixel(nothing, left, lanes_of<Count>(above), corner);
    const LaneBytes difference = LaneBytes(lanes_of<Count>(row)) - LaneBytes(predicted);
    const LaneBytes negated = LaneBytes(nothing) - difference;
    store<Count>(Lanes(difference), differences);
    return Lanes(difference < negated ? difference : negated);
}

inline int64_t total(Lanes lanes) {
    int64_t sum = 0;
    for (int i = 0; i < 8; ++i) sum += lanes[i];
    return sum;
}

// The row filtered; returns the sum of the sizes of its differences.
template <class Filter>
int64_t filter_row(const uint8_t *row, const uint8_t *above, int64_t row_bytes, int pixel_bytes,
                   uint8_t *differences) {
    int64_t sum = 0, i = 0;
    for (; i < pixel_bytes; ++i)
        sum += total(filter_bytes<Filter, 1>(row + i, above + i, 0, differences + i));
    while (i + 8 <= row_bytes) {
        Lanes part = {};  // sums of so many sizes fit 16 bits
        for (int n = 0; n < 255 && i + 8 <= row_bytes; ++n, i += 8)
            part += filter_bytes<Filter, 8>(row + i, above + i, pixel_bytes, differences + i);
        sum += total(part);
    }
    for (; i < row_bytes; ++i)
        sum += total(filter_bytes<Filter, 1>(row + i, above + i, pixel_bytes, differences + i));
    return sum;
}

// In the order of their numbers.
using FilterRow = int64_t (*)(const uint8_t *, const uint8_t *, int64_t, int, uint8_t *);
constexpr FilterRow kFilters[] = {filter_row<None>, filter_row<Sub>, filter_row<Up>, filter_row<Average>,
                                  filter_row<Paeth>};

void filter(const uint8_t *rows, int64_t count, int64_t row_bytes, int pixel_bytes,
            uint8_t *filtered) {
    std::vector<uint8_t> scratch(size_t(2 * row_bytes));
    for (int64_t y = 0; y < count; ++y, rows += row_bytes, filtered += row_bytes + 1) {
        // What is above the first row is not known: those that look there are left out.
        const uint8_t *above = y ? rows - row_bytes : rows;
        const int last = y ? kPaeth : kSub;
        uint8_t *best = scratch.data(), *next = best + row_bytes;
        int64_t least = kFilters[kNone](rows, above, row_bytes, pixel_bytes, best);
        filtered[0] = kNone;
        for (int number = kSub; number <= last && least; ++number) {
            const int64_t sum = kFilters[number](rows, above, row_bytes, pixel_bytes, next);
            if (sum >= least) continue;
            least = sum;
            filtered[0] = uint8_t(number);
            std::swap(best, next);
        }
        std::memcpy(filtered + 1, best, size_t(row_bytes));
    }
}

}  // namespace

#define HPCOMP_JOINED(prefix, level) prefix##level
#define HPCOMP_SYMBOL(prefix, level) HPCOMP_JOINED(prefix, level)
extern const Packing HPCOMP_SYMBOL(packing_, HPCOMP_LEVEL);
const Packing HPCOMP_SYMBOL(packing_, HPCOMP_LEVEL) = {merge, interleave, pack, unfilter, filter};

}  // namespace hpcomp
