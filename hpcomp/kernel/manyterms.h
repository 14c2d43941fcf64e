// The order `simultaneous` for one pixel of many terms, without a table of all their pairs.

#pragma once

#include "block.h"

namespace hpcomp {

// The sum of `n` terms of p (count, 2, kBlock), those of the numbers `there`, each of which has chroma,
// in the column at which `p` begins. `scratch` holds `many_terms_floats` and is aligned as doubles are. The
// order of the terms changes no bit.
void sum_of_many(const Rules &rules, const float *p, const int *there, int n, float *scratch,
                  float *sum0, float *sum1);

}  // namespace hpcomp
