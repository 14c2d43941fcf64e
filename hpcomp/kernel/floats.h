// Floats as bits, halves, and the planes of a block. For the loops alone: see `block.h`.

#pragma once

#include <cstring>

#include "block.h"

#define HPCOMP_INLINE static inline __attribute__((always_inline))

namespace hpcomp {
namespace {

using Plane = float[kBlock];
// Planes, or parts of them, that no other overlaps.
using Row = float *__restrict__;
using ConstRow = const float *__restrict__;

// A light of a block with planes of its own.
struct LightPlanes {
    Plane luminance, p0, p1, red, green, blue, strength;

    Light light(Strength by = Strength::kChroma) {
        return {luminance, p0, p1, red, green, blue, by == Strength::kChroma ? nullptr : strength};
    }
};

HPCOMP_INLINE uint32_t bits_of(float value) {
    uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

HPCOMP_INLINE float float_of(uint32_t bits) {
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

HPCOMP_INLINE float magnitude(float x) { return float_of(bits_of(x) & 0x7fffffffu); }
HPCOMP_INLINE double magnitude(double x) { return x < 0 ? -x : x; }
HPCOMP_INLINE float smaller(float a, float b) { return a < b ? a : b; }
HPCOMP_INLINE double smaller(double a, double b) { return a < b ? a : b; }
HPCOMP_INLINE float larger(float a, float b) { return a > b ? a : b; }
HPCOMP_INLINE double larger(double a, double b) { return a > b ? a : b; }
// NaN stays NaN.
HPCOMP_INLINE float at_most_one(float x) { return x > 1 ? 1.0f : x; }
HPCOMP_INLINE bool is_finite(float a, float b, float c, float d) { return (a * 0 + b * 0) + (c * 0 + d * 0) == 0; }
HPCOMP_INLINE float clamped(float x) { return x < 0 ? 0.0f : at_most_one(x); }

// The power of two that brings the largest of four numbers near 1, and its inverse: squares of tiny
// and huge colours stay in the range of the type, and scaling by it rounds nothing.
struct Scale {
    float down, up;
};
HPCOMP_INLINE Scale scale_of(float a, float b, float c, float d) {
    const float largest = larger(larger(magnitude(a), magnitude(b)), larger(magnitude(c), magnitude(d)));
    uint32_t exponent = bits_of(largest) & 0x7f800000u;
    exponent = exponent < 0x00800000u ? 0x00800000u : exponent;
    exponent = exponent > 0x7e800000u ? 0x7e800000u : exponent;
    return {float_of(0x7f000000u - exponent), float_of(exponent)};
}

HPCOMP_INLINE float from_half(uint16_t half) {
    const uint32_t sign = uint32_t(half & 0x8000u) << 16;
    // The exponent moves by a multiplication, which also makes subnormals right.
    const float scaled = float_of(uint32_t(half & 0x7fffu) << 13) * 0x1p112f;
    const uint32_t special = (half & 0x7c00u) == 0x7c00u ? 0x7f800000u : 0u;
    return float_of(bits_of(scaled) | special | sign);
}

// Whatever NaN came in, the same comes out: its sign and payload are the compiler's choice.
HPCOMP_INLINE float one_nan(float x) { return x != x ? float_of(0x7fc00000u) : x; }

HPCOMP_INLINE uint16_t to_half(float value) {
    const uint32_t bits = bits_of(one_nan(value));
    const uint32_t sign = bits & 0x80000000u;
    const uint32_t size = bits ^ sign;
    // Below the normal halves the addition of a half rounds; above, the carry into the exponent.
    const uint32_t tiny = bits_of(float_of(size) + 0.5f) - 0x3f000000u;
    const uint32_t normal = (size - 0x38000000u + 0xfffu + ((size >> 13) & 1u)) >> 13;
    const uint32_t special = size > 0x7f800000u ? 0x7e00u : 0x7c00u;
    const uint32_t finite = size < 0x38800000u ? tiny : normal;
    return uint16_t((size >= 0x47800000u ? special : finite) | (sign >> 16));
}

}  // namespace
}  // namespace hpcomp
