// Interpolation of fields on a grid to another one, along columns and then along rows.
#include "resample.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "../base/arrays.hpp"
#include "../base/geometry.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

using Index = In<int, 2>;
using Weight = In<float, 2>;

Taps taps(const Index& index, const Weight& weight, int old) {
  const int count = int(index.shape(1));
  need(index.shape(0) >= 1 && index.shape(0) <= kTaps, "1 to 4 taps");
  need(shaped(weight, {index.shape(0), index.shape(1)}), "one weight for every index");
  for (std::size_t i = 0; i < index.size(); ++i) need(index.data()[i] >= 0 && index.data()[i] < old, "no such sample");
  Taps all = {int(index.shape(0)), count, padded(count), {}, {}};
  for (int t = 0; t < all.taps; ++t)
    for (int c = 0; c < all.stride; ++c) {
      const int from = t * count + std::min(c, count - 1);
      all.index.push_back(index.data()[from]), all.weight.push_back(weight.data()[from]);
    }
  return all;
}

void resample(const Grids& grids, In<float, 4> field, Out<float, 4> out) {
  const std::size_t batch = field.shape(0), planes = field.shape(1);
  need(shaped(field, {batch, planes, std::size_t(grids.h), std::size_t(grids.w)}),
       "the field must be (B, K, old rows, old cols)");
  need(shaped(out, {batch, planes, std::size_t(grids.rows.count), std::size_t(grids.cols.count)}),
       "out must be (B, K, new rows, new cols)");
  grids(field.data(), int(batch * planes), out.data());
}

void place_all(Out<float, 4> field, In<double, 3> driven, In<int, 1> handles, In<int, 1> near, In<int, 1> guides,
               In<float, 1> pull, double rounding) {
  const std::size_t batch = field.shape(0), n = field.shape(2) * field.shape(3), count = handles.shape(0);
  need(field.shape(1) == 3 && shaped(driven, {batch, count, 3}), "field must be (B, 3, H, W), driven (B, N, 3)");
  need(guides.shape(0) == near.shape(0) && pull.shape(0) == near.shape(0), "as many guides and pulls as near");
  std::vector<int> all(count);
  std::iota(all.begin(), all.end(), 0);
  const Pulled pulled = {near.data(), guides.data(), pull.data(), near.shape(0)};
  for (std::size_t b = 0; b < batch; ++b)
    place(field.data() + 3 * b * n, n, driven.data() + 3 * b * count, all.data(), handles.data(), count, pulled,
          rounding);
}

// Positions (B, M, 3) of coarse handles at their offsets from the fine ones (B, N, 3) that they follow, and velocities.
nb::tuple follow(In<double, 3> positions, In<double, 3> velocities, In<int, 1> follows, In<double, 3> offsets) {
  const std::size_t batch = positions.shape(0), fine = positions.shape(1), count = follows.shape(0);
  need(shaped(positions, {batch, fine, 3}) && shaped(velocities, {batch, fine, 3}), "handles must be (B, N, 3)");
  need(shaped(offsets, {batch, count, 3}), "offsets must be (B, M, 3)");
  Array x = fresh({batch, count, 3}), v = fresh({batch, count, 3});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i) {
      need(std::size_t(follows.data()[i]) < fine, "no such handle");
      const std::size_t from = 3 * (b * fine + follows.data()[i]), to = 3 * (b * count + i);
      for (std::size_t k = 0; k < 3; ++k) {
        x.data()[to + k] = positions.data()[from + k] + offsets.data()[to + k];
        v.data()[to + k] = velocities.data()[from + k];
      }
    }
  return nb::make_tuple(x, v);
}

}  // namespace

void place(float* field, std::size_t n, const double* driven, const int* numbers, const int* held, std::size_t count,
           const Pulled& pulled, double rounding) {
  thread_local std::vector<float> memory;
  memory.resize(count);
  float* const missing = memory.data();
  for (std::size_t k = 0; k < 3; ++k, field += n) {
    bool off = false;
    for (std::size_t i = 0; i < count; ++i) {
      const float there = float(driven[3 * numbers[i] + k]);
      float& here = field[held[i]];
      missing[i] = there - here;
      off |= std::abs(missing[i]) > rounding;
      here = there;
    }
    if (!off) continue;
    for (std::size_t i = 0; i < pulled.count; ++i) field[pulled.near[i]] += pulled.pull[i] * missing[pulled.guides[i]];
  }
}

void bind_resample(nb::module_& m) {
  m.def("follow", &follow, "Positions and velocities of coarse handles that follow fine ones.");
  m.def("place", &place_all, nb::arg("field"), nb::arg("driven"), nb::arg("handles"), nb::arg("near"),
        nb::arg("guides"), nb::arg("pull"), nb::arg("rounding"),
        "Puts handles where they are driven and shares what is missing with the vertices around.");
  nb::class_<Grids>(m, "Resample", "Writes (B, K, h, w) on another grid to out, by taps along rows and columns.")
      .def("__init__",
           [](Grids* self, int h, int w, Index row_index, Weight row_weight, Index col_index, Weight col_weight) {
             new (self) Grids{h, w, taps(row_index, row_weight, h), taps(col_index, col_weight, w)};
           })
      .def("__call__", &resample);
}

}  // namespace minicloth
