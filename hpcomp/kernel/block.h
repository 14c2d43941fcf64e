// One block of pixels from stored samples to the accumulated stack, and from there to samples.
// Plain loops over planes that stay in cache and that any compiler vectorises. Everything here has
// internal linkage: the file is compiled once per instruction set, and no clone may leak out.
// Only arithmetic whose result IEEE 754 fixes is used, so every clone gives the same bits.

#pragma once

#include <cstdint>

namespace hpcomp {

// Pixels of a block: its planes fill the L1 cache, its terms the L2.
constexpr int kBlock = 256;
// Pixels whose terms are compared in pairs at a time.
constexpr int kLanes = 16;

enum class Sample : int { kU8, kU16, kHalf, kFloat };
enum class Factor : int { kZero, kOne, kAlpha, kRest };
enum class Blending : int { kHuePreserving, kTraditional, kForemost, kWoven };
enum class Order : int { kBottomUp, kFrontToBack, kPermutation, kBalanced, kSimultaneous, kWoven };
enum class Strength : int { kChroma, kPerceived, kCoverage };
enum class Pattern : int { kStripes, kNoise };

// Terms of a pixel up to which all pairs of them are tabled; more are sorted by hue, see `manyterms.h`. Pixels
// side by side share a table, though their terms may be others.
constexpr int kPairedTerms = 32, kTabledTerms = 64;

// So that what follows is aligned as doubles are.
constexpr int64_t rounded_up(int64_t floats) { return (floats + 1) / 2 * 2; }

// Scratch of a reduction of `n` terms of so many layers, in floats: the seven planes of each term, its factors and what is
// kept of it; at once also the numbers of those with chroma, and the tables of pairs or what sorted terms
// take, and these themselves. The pairs have their shoulders and supports, four rows of each term, and as
// ints its neighbors and their number. Woven terms, of which the background is one, have their hues and
// strengths. What is added one by one has the pairs in which it is. All have the numbers of their layers.
constexpr int64_t kTermPlanes = 10;
constexpr int64_t term_floats(int64_t n) { return n * kTermPlanes * kBlock; }
constexpr int64_t tabled(int64_t n) { return n < kTabledTerms ? n : kTabledTerms; }
constexpr int64_t number_floats(int64_t n) { return rounded_up(n + (tabled(n) + 1) * tabled(n)); }
constexpr int64_t pair_floats(int64_t n) { return (2 * tabled(n) + 4) * tabled(n) * kLanes; }
constexpr int64_t sorting_doubles(int64_t n) { return 23 * n + 5; }
constexpr int64_t run_doubles(int64_t n) { return 4 * n + sorting_doubles(n); }
constexpr int64_t many_terms_floats(int64_t n) { return n > kPairedTerms ? 2 * run_doubles(n) : 0; }
constexpr int64_t weaving_floats(int64_t n) { return 2 * rounded_up(n) + 6 * n * kLanes; }
constexpr int64_t reducing_floats(Order order, int64_t n, int64_t layers) {
    if (order == Order::kWoven) return weaving_floats(n);
    if (order != Order::kSimultaneous) return rounded_up(2 * n + layers);
    const int64_t pairs = pair_floats(n), many = many_terms_floats(n);
    return number_floats(n) + (pairs > many ? pairs : many);
}
constexpr int64_t scratch_floats(Order order, int64_t there, int64_t layers) {
    const int64_t n = there + (order == Order::kWoven ? 1 : 0);
    return term_floats(n) + reducing_floats(order, n, layers) + rounded_up(n);
}

// What the maps between colours and p are.
enum class Maps : int { kLinear, kHsl, kOklab, kCielab };

// Oklab in numbers: pairs of coefficients beside the middle one of three, see `uniformspaces.py`.
struct OklabNumbers {
    float to_lms[3][2], to_lab[3][2], to_roots[3][2], from_lms[3][2];
    float inverse_largest;   // 1 over the bound of |p|/Y
};
struct CielabNumbers {
    float to_xz[2][2], from_xz[3][2];
    float inverse_largest;
};

// A blending space in numbers.
struct SpaceMaps {
    Maps maps;               // kHsl changes the length of p, the others have numbers of their own
    float weight_red, weight_blue;       // luminance weights
    float to_p[2][2];        // p from red - green and blue - green
    float from_p[3][2];      // what p adds to each channel
    OklabNumbers oklab;
    CielabNumbers cielab;
    float slack_lo, slack_hi;            // of the gamut, in luminances: see `gamut.py`
};

// One layer's strip: rows of interleaved samples and what they mean.
struct Layer {
    const void *samples;
    int64_t row_bytes;
    Sample type;
    int channels;           // 1 Y, 2 Y and alpha, 3 RGB, 4 RGBA
    int alpha_straight;     // colours are to be multiplied by alpha
    const float *decode;    // linear light of each code; integers only
    int has_matrix;
    float matrix[3][2];     // to the working primaries: of red and blue less green, beside green
    int left, top, width, height;  // its rectangle in the strip
    float opacity;
    Factor factor_a, factor_b;
    int behind;             // put behind the layers below it, not in front of them
    int zero_nonfinite;     // else NaN and Inf are kept, and counted either way
};

// The pattern of woven blending: its size in pixels, and of noise a tile whose cells are numbered.
struct Weave {
    Pattern pattern;
    int size;
    const uint16_t *tile;    // (side, side): each number below side * side once
    int side;
};

struct Rules : SpaceMaps {
    Blending blending;
    Strength strength;
    OklabNumbers perception; // what strengths but chroma are measured with
    float half_chroma;       // at which a colour has half the strength of its coverage
    Weave weave;
    int bounded;             // results are brought back into gamut
    float rounding_angle;    // up to which hues are one but for rounding
    float tolerance, inverse_tolerance;  // radians; the inverse is 0 for a hard switch
    float end_sine, end_cosine;          // of the angle from which hues differ
    float gray_power;        // by how much the power of what hues cancel is above 1: 3b
    Order order;
    const int *permutation;  // of the layers, for kPermutation
    int layers;
    int has_background;
    float background_luminance, background_p[2], background_rgb[3];
    float background_bounds[2], background_strength;
    float gain;              // 2 to the exposure
};

// Planes of a colour, or of a sum of such. Where the maps are linear red, green and blue are the colour;
// else they are the plain sum of the colours that went in, which is the colour where (+) did nothing else.
// What competes is the strength; null where that is the length of p.
struct Light {
    float *luminance, *p0, *p1, *red, *green, *blue, *strength;
};

// Planes of the strip so far: its light, its alpha, the transmittance in front, and what bounds the
// channels of the result; null where they are not needed. `phase`: of the weave; null where it follows from
// `left`, `top`: the first pixel, from the corner of the canvas.
struct State {
    Light light;
    float *alpha, *transmittance, *lo, *hi;
    const float *phase;
    int left, top;
};

// How linear light becomes the codes of integer samples.
struct Codes {
    const float *thresholds;    // linear light where each next code begins
    const uint16_t *first_code; // the code at the beginning of each bucket
    int bucket_bits;            // buckets an octave, as a power of two
    float smallest;             // a power of two below the first threshold: where buckets begin
    float lowest, darkest, highest;  // half a code value outside and above black
    int has_matrix;
    float matrix[3][2];         // from the working primaries to those of the codes, as in `Layer`
    double weights[3];          // luminance of these
    SpaceMaps space;            // for these: that whose hue codes keep
};

// Where a result goes: one of four kinds of sample, RGBA interleaved. Floats have no codes.
struct Output : Codes {
    void *samples;
    Sample type;
};

struct Losses {
    int64_t out_of_gamut, light_without_alpha, not_a_number, beyond_half;
};

// Is shown each block of each layer on its way, and then where the block is; `self` is its own.
struct Observer {
    void *self;
    // Planes of `n` pixels of layer `number` from column x of row y on: its colours and alpha, luminance and p.
    void (*term)(void *self, int number, int x, int y, int n, const float *red, const float *green, const float *blue,
                 const float *alpha, const float *luminance, const float *p0, const float *p1);
    void (*block)(void *self, int x, int y, int n);
};

// What the binding calls; one set for each instruction set. An observer may be null.
struct Engine {
    // Adds layers to the accumulated strip of `width` x `height`; `nonfinite` counts pixels a layer. The bottom
    // layer is one of them once; others may be missing that have no pixels in the strip and erase nothing.
    void (*add)(const Rules &, const Layer *, const int *numbers, int count, int width, int height,
                const State &, int64_t *nonfinite, const Observer *);
    // Reduces all layers of a strip at once, into `State`.
    void (*reduce)(const Rules &, const Layer *, const int *numbers, int count, int width, int height,
                   const State &, float *scratch, int64_t *nonfinite, const Observer *);
    // The strip over its background, exposed, as samples.
    void (*finish)(const Rules &, int64_t pixels, const State &, const Output &, Losses *);
};

}  // namespace hpcomp
