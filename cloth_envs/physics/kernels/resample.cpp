// Interpolation of fields on a grid to another one, along columns and then along rows.
#include "resample.hpp"

#include <cmath>
#include <vector>

#include "arrays.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

constexpr std::size_t kTaps = 4;

// to[c] = the sum of term(t, c) over the taps t, of which there are 1 to 4.
template <class Term>
void combine(std::size_t taps, std::size_t count, float* to, const Term& term) {
  switch (taps) {
    case 1:
      for (std::size_t c = 0; c < count; ++c) to[c] = term(0, c);
      break;
    case 2:
      for (std::size_t c = 0; c < count; ++c) to[c] = term(0, c) + term(1, c);
      break;
    case 3:
      for (std::size_t c = 0; c < count; ++c) to[c] = term(0, c) + term(1, c) + term(2, c);
      break;
    default:
      for (std::size_t c = 0; c < count; ++c) to[c] = (term(0, c) + term(1, c)) + (term(2, c) + term(3, c));
  }
}

// out = R field C^T for planes of (B, K, h, w): every new row or column is a weighted sum of some old ones, tap t of
// which is number index(t, new) with weight(t, new).
void resample(In<float, 4> field, In<int, 2> row_index, In<float, 2> row_weight, In<int, 2> col_index,
              In<float, 2> col_weight, Out<float, 4> out) {
  const std::size_t planes = field.shape(0) * field.shape(1), h = field.shape(2), w = field.shape(3);
  const std::size_t rows = row_index.shape(1), cols = col_index.shape(1);
  const std::size_t row_taps = row_index.shape(0), col_taps = col_index.shape(0);
  need(row_taps >= 1 && row_taps <= kTaps && col_taps >= 1 && col_taps <= kTaps, "1 to 4 taps");
  need(shaped(out, {field.shape(0), field.shape(1), rows, cols}), "out must be (B, K, new rows, new cols)");
  need(shaped(row_weight, {row_taps, rows}) && shaped(col_weight, {col_taps, cols}), "one weight for every index");
  for (std::size_t i = 0; i < row_taps * rows; ++i) need(std::size_t(row_index.data()[i]) < h, "no such row");
  for (std::size_t i = 0; i < col_taps * cols; ++i) need(std::size_t(col_index.data()[i]) < w, "no such column");
  thread_local std::vector<float> wide;
  wide.resize(h * cols);
  for (std::size_t p = 0; p < planes; ++p) {
    for (std::size_t r = 0; r < h; ++r)
      combine(col_taps, cols, wide.data() + r * cols, [&](std::size_t t, std::size_t c) {
        return col_weight.data()[t * cols + c] * field.data()[(p * h + r) * w + col_index.data()[t * cols + c]];
      });
    for (std::size_t r = 0; r < rows; ++r) {
      const float* line[kTaps];
      float weight[kTaps];
      std::size_t taps = 0;
      for (std::size_t t = 0; t < row_taps; ++t)
        if (row_weight.data()[t * rows + r] != 0) {
          weight[taps] = row_weight.data()[t * rows + r];
          line[taps++] = wide.data() + std::size_t(row_index.data()[t * rows + r]) * cols;
        }
      combine(taps, cols, out.data() + (p * rows + r) * cols,
              [&](std::size_t t, std::size_t c) { return weight[t] * line[t][c]; });
    }
  }
}

// Puts the vertices `handles` of (B, 3, H, W) to driven (B, N, 3). Where one is off by more than `rounding`, the
// vertices `near` take their pull of what is missing at the handle number `guides`.
void place(Out<float, 4> field, In<double, 3> driven, In<int, 1> handles, In<int, 1> near, In<int, 1> guides,
           In<float, 1> pull, double rounding) {
  const std::size_t batch = field.shape(0), n = field.shape(2) * field.shape(3), count = handles.shape(0);
  need(field.shape(1) == 3 && shaped(driven, {batch, count, 3}), "field must be (B, 3, H, W), driven (B, N, 3)");
  need(guides.shape(0) == near.shape(0) && pull.shape(0) == near.shape(0), "as many guides and pulls as near");
  std::vector<float> missing(count);
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < 3; ++k) {
      float* plane = field.data() + (3 * b + k) * n;
      bool off = false;
      for (std::size_t i = 0; i < count; ++i) {
        const float there = float(driven.data()[(b * count + i) * 3 + k]);
        float& here = plane[handles.data()[i]];
        missing[i] = there - here;
        off |= std::abs(missing[i]) > rounding;
        here = there;
      }
      if (!off) continue;
      for (std::size_t i = 0; i < near.shape(0); ++i)
        plane[near.data()[i]] += pull.data()[i] * missing[guides.data()[i]];
    }
}

}  // namespace

void bind_resample(nb::module_& m) {
  m.def("place", &place, "Puts handles where they are driven and shares what is missing with the vertices around.");
  m.def("resample", &resample, "Writes (B, K, h, w) on another grid to out, by taps along rows and columns.");
}

}  // namespace minicloth
