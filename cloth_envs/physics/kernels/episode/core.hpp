// Whether a state is sound.
#pragma once
#include "../base/dispatch.hpp"

namespace minicloth {

struct Check {
  bool finite;
  double strain;   // of the longest structural edge
  double kinetic;  // energy per mass [J/kg], vertices weighted alike
};

template <class T>
struct StateLanes {
  // Whether a state is sound. Unpadded arrays (3, rows, cols).
  Check (*check)(const T* x, const T* v, int rows, int cols, T row_length, T col_length, bool periodic);
};
DECLARE_LANES(StateLanes<float>)
DECLARE_LANES(StateLanes<double>)

}  // namespace minicloth
