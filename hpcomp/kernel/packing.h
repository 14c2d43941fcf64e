// How codecs lay samples out in the bytes that they deflate: EXR's blocks, PNG's rows. Integers
// only; compiled once per instruction set, like the blocks of pixels.

#pragma once

#include <cstdint>

namespace hpcomp {

// Rows of an EXR block: planes of channels one after another in each row, in units of 16 bits, so
// that a half is one unit and a float two.
struct PlanarRows {
    int64_t row_units;         // of all channels of the file
    const int64_t *channels;   // where each wanted channel begins in a row, in units
    int count;                 // of wanted channels
    int units;                 // of a sample
    int64_t width;
};

struct Packing {
    // Undoes the differences and the split into even and odd bytes: `bytes`, an even number, of an
    // inflated block to as many.
    void (*merge)(const uint8_t *packed, int64_t bytes, uint8_t *split, uint16_t *merged);
    // Gathers wanted channels of rows as interleaved samples.
    void (*interleave)(const PlanarRows &, const uint16_t *planar, int64_t rows, uint16_t *out);
    // Rows of interleaved samples as what ZIP compresses: planes of the channels in each row, the last
    // one first as RGBA is stored, split into even and odd bytes, and the difference of each byte to
    // the one before it.
    void (*pack)(const uint16_t *samples, int channels, int units, int64_t width, int64_t rows,
                 uint8_t *split, uint8_t *packed);
    // The rows of a PNG from filtered ones, each behind its filter's number. False for a number
    // that is none. `above`: the row before the first.
    bool (*unfilter)(const uint8_t *filtered, int64_t rows, int64_t row_bytes, int pixel_bytes,
                     const uint8_t *above, uint8_t *out);
    // Each row by the filter that has the least sum of absolute differences, of equal ones the first.
    // Those that look above are not for the first row.
    void (*filter)(const uint8_t *rows, int64_t count, int64_t row_bytes, int pixel_bytes,
                   uint8_t *filtered);
};

}  // namespace hpcomp
