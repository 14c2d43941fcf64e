// The order `simultaneous` for one pixel of many terms, without a table of all their pairs.

#pragma once

#include "block.h"

namespace hpcomp {

// What is kept of `n` terms of p (count, 2, kBlock), those of the numbers `there`, each of which has
// chroma, in the column at which p begins: factors, set in the column at which `kept` (count, kBlock)
// begins, but where a term is not finite. `scratch` holds `many_terms_floats` and is aligned as doubles
// are. The order of the terms changes no bit.
void keep_of_many(const Rules &rules, const float *p, const int *there, int n, float *scratch, float *kept);

}  // namespace hpcomp
