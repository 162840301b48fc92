// Interpolation of fields on a grid to another one, along columns and then along rows.
#include "resample.hpp"

#include <vector>

#include "arrays.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

// out = R field C^T for planes of (B, K, h, w): every new row or column is a weighted sum of some old ones, tap t of
// which is number index(t, new) with weight(t, new).
void resample(In<float, 4> field, In<int, 2> row_index, In<float, 2> row_weight, In<int, 2> col_index,
              In<float, 2> col_weight, Out<float, 4> out) {
  const std::size_t planes = field.shape(0) * field.shape(1), h = field.shape(2), w = field.shape(3);
  const std::size_t rows = row_index.shape(1), cols = col_index.shape(1);
  const std::size_t row_taps = row_index.shape(0), col_taps = col_index.shape(0);
  need(shaped(out, {field.shape(0), field.shape(1), rows, cols}), "out must be (B, K, new rows, new cols)");
  need(shaped(row_weight, {row_taps, rows}) && shaped(col_weight, {col_taps, cols}), "one weight for every index");
  for (std::size_t i = 0; i < row_taps * rows; ++i) need(std::size_t(row_index.data()[i]) < h, "no such row");
  for (std::size_t i = 0; i < col_taps * cols; ++i) need(std::size_t(col_index.data()[i]) < w, "no such column");
  std::vector<float> wide(h * cols);
  for (std::size_t p = 0; p < planes; ++p) {
    const float* from = field.data() + p * h * w;
    for (std::size_t r = 0; r < h; ++r) {
      float* to = wide.data() + r * cols;
      for (std::size_t t = 0; t < col_taps; ++t) {
        const int* index = col_index.data() + t * cols;
        const float* weight = col_weight.data() + t * cols;
        for (std::size_t c = 0; c < cols; ++c) to[c] = (t ? to[c] : 0.0f) + weight[c] * from[r * w + index[c]];
      }
    }
    for (std::size_t r = 0; r < rows; ++r) {
      float* to = out.data() + (p * rows + r) * cols;
      for (std::size_t t = 0; t < row_taps; ++t) {
        const float weight = row_weight.data()[t * rows + r];
        const float* line = wide.data() + std::size_t(row_index.data()[t * rows + r]) * cols;
        for (std::size_t c = 0; c < cols; ++c) to[c] = (t ? to[c] : 0.0f) + weight * line[c];
      }
    }
  }
}

}  // namespace

void bind_resample(nb::module_& m) {
  m.def("resample", &resample, "Writes (B, K, h, w) on another grid to out, by taps along rows and columns.");
}

}  // namespace minicloth
