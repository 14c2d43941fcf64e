// The instruction sets that the loops were compiled for.

#pragma once

#include <string>
#include <vector>

#include "block.h"
#include "measure.h"
#include "packing.h"

namespace hpcomp {

struct Level {
    const char *name;
    const Engine *engine;
    const Packing *packing;
    const Measuring *measuring;
};

// Those that this processor runs, the fastest last.
const std::vector<Level> &levels();

// The level of that name, the fastest for an empty one; throws std::invalid_argument.
const Level &level_of(const std::string &name);

}  // namespace hpcomp
