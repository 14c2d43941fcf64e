// What blending did to the hues of a stack: sums over the pixels of a strip. All sums are integers,
// values counted in units of 2^-24, so that they do not depend on strips, threads or processors.

#pragma once

#include "block.h"

namespace hpcomp {

struct MeasureRules {
    float half_step;            // |p| above which a term contributes, and a result has chroma
    float achromatic;           // saturation below which a colour is grey
    float sine, cosine;         // of the angle beyond which a hue is foreign
    int depends_on_order;       // whether another order gives another result
    int bins;                   // of the hue histograms
};

// A row of a histogram: pixels, and their sums; padded to a cache line.
constexpr int kHueColumns = 8;
enum HueColumn { kCount, kChroma, kAlpha, kRed, kGreen, kBlue };
// Pixels without a bin.
struct OtherPixels {
    int64_t grey, transparent, nonfinite;
};
// Of one result: pixels and sums, and those of each layer and of the background.
struct ResultSums {
    int64_t chromatic, chroma, foreign, foreign_chroma, light[3];
};
struct ContributorSums {
    int64_t pixels, survived, visible, chroma, kept;  // `visible` is summed from the cells
};

// Cells of the canvas in which a label is looked for, a square each: pixels to which a term contributes, and
// of which results one of them has its hue, a bit for each `Result`.
constexpr int kCell = 16;
struct Cell {
    uint16_t pixels, shown;
};
struct Cells {
    Cell *first;    // (rows, layers there + 1, columns)
    int columns;    // that the strip touches
    int left, top;  // where in its cell the strip's first pixel is
};

// The values of each pixel, where they are wanted; else null.
struct Provenance {
    uint32_t *layer;
    float *grey, *margin;
};

// Pictures that are `scale` times smaller: of each square of pixels the sums of red, green, blue and alpha.
struct Squares {
    int64_t *first;      // (layers + kResults, rows, columns, 4): the layers', then the results'; null: not wanted
    int scale;
    int rows, columns;
    int top;             // rows of the uppermost squares that lie above the strip
};

// Which result: those of pixels in which both are the same are counted once, and added afterwards.
enum Result { kAsBlended, kTraditional, kBothResults, kResults };

// Everything is added to what is there, but for the provenance, which is set. `layers` are those that are there in
// the strip, bottom first, and after them comes the background.
struct Measures {
    int64_t unmeasured, order_sensitive;
    ResultSums *results;            // (kResults)
    ContributorSums *contributors;  // (kResults, layers + 1)
    int64_t *hues;                  // (layers + kResults, bins, kHueColumns): the layers', then the results'
    OtherPixels *others;            // (layers + kResults)
    Provenance provenance;
    Cells cells;
    Squares squares;
};

// Floats of scratch for `n` terms of so many layers.
constexpr int64_t measure_floats(Order order, int64_t n, int64_t layers) {
    return (n + 1) * 10 * kBlock + scratch_floats(order, n, layers);
}

// Measures all layers of a strip as they are composited, bottom first or from the front.
struct Measurer {
    const Rules *rules;
    const MeasureRules *measures;
    const Layer *layers;  // of all numbers
    const int *places;    // of all numbers among those that are there in the strip, and of the background
    int all, count;       // layers of the stack, and those of them
    int width, top;       // of the strip; the row of it where the rows begin that are composited
    int terms;            // of the layers that have come in this block
    float *scratch;       // `measure_floats`, zeros before the first block
    Measures *found;
};

// What an observer calls whose own is a `Measurer`.
struct Measuring {
    decltype(Observer::term) term;
    decltype(Observer::block) block;
};

}  // namespace hpcomp
