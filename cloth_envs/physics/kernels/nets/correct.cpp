// The correction of the coarse dynamics for Python.
#include "correct.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <utility>

#include "../base/arrays.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

Plane<float> copy(const float* from, std::size_t count) {
  Plane<float> to(count, 0.0f);
  std::copy_n(from, count, to.begin());
  return to;
}

// Rows (K, V) with the last vertex again up to whole blocks.
template <class T, class To>
void pad_rows(const T* from, std::size_t rows, const Correct& net, To& to) {
  to.resize(rows * std::size_t(net.width));
  for (std::size_t r = 0; r < rows; ++r)
    for (int i = 0; i < net.width; ++i) to[r * net.width + i] = from[r * net.vertices + std::min(i, net.vertices - 1)];
}

void make_correct(Correct* self, const std::vector<In<int, 2>>& index, In<float, 1> nearer, In<float, 2> place,
                  In<float, 1> share, const std::vector<In<float, 2>>& weights, const std::vector<In<float, 1>>& biases,
                  In<float, 1> low, In<float, 1> high, In<float, 1> limit, double spacing, double frame_dt, bool wind,
                  const std::vector<bool>& planes, const std::vector<float>& radii) {
  const int n = int(share.shape(0));
  need(index.size() == 3 && weights.size() == kCorrectLayers && biases.size() == kCorrectLayers, "three of each");
  Correct net{};
  net.vertices = n, net.width = padded(n);
  net.near = int(index[0].shape(0)), net.moving = int(index[1].shape(0)), net.changing = int(index[2].shape(0));
  net.places = int(place.shape(0));
  int inputs = 3 * (net.near + net.moving + net.changing + 3 + wind) + net.places;
  for (bool plane : planes) inputs += plane ? 1 : 4;
  need(net.near >= 8 && net.near <= 32 && nearer.shape(0) == index[0].shape(0), "8 to 32 neighbours");
  need(planes.size() == radii.size() && planes.size() <= 16 && shaped(limit, {6}), "at most 16 bodies, 6 limits");
  need(shaped(low, {std::size_t(inputs)}) && shaped(high, {std::size_t(inputs)}), "low and high must be (features,)");
  for (const auto& part : index) {
    need(int(part.shape(1)) == n, "index must be (neighbours, V)");
    for (std::size_t k = 0; k < part.size(); ++k) need(part.data()[k] >= 0 && part.data()[k] < n, "index beyond V");
    std::vector<int> rows;
    pad_rows(part.data(), part.shape(0), net, rows);
    net.index.insert(net.index.end(), rows.begin(), rows.end());
  }
  need(int(place.shape(1)) == n, "place must be (numbers, V)");
  net.nearer.assign(nearer.data(), nearer.data() + nearer.shape(0));
  pad_rows(place.data(), place.shape(0), net, net.place);
  pad_rows(share.data(), 1, net, net.share);
  net.low = copy(low.data(), inputs), net.high = copy(high.data(), inputs);
  std::copy_n(limit.data(), 6, net.limit);
  net.spacing = float(spacing), net.frame_dt = float(frame_dt), net.wind = wind;
  net.planes = planes, net.radii = radii;
  for (int l = 0; l < kCorrectLayers; ++l) {
    const auto& w = weights[l];
    need(int(w.shape(1)) == inputs && biases[l].shape(0) == w.shape(0) && (l < kCorrectLayers - 1 || w.shape(0) == 6),
         "weights must be (out, in), biases (out,), 6 at last");
    net.layers[l] = {w.data(), int(w.shape(0)), inputs};
    need(net.layers[l].fits(), "a layer may have 256 numbers");
    net.biases[l] = copy(biases[l].data(), w.shape(0));
    inputs = int(w.shape(0));
  }
  new (self) Correct(std::move(net));
}

void apply_correct(const Correct& net, In<float, 4> old, In<float, 2> wind, In<float, 4> bodies, Out<float, 4> x,
                   Out<float, 4> v) {
  const std::size_t batch = x.shape(0), size = 3 * std::size_t(net.vertices);
  need(x.shape(1) == 3 && x.size() == batch * size, "positions must be (B, 3, h, w) of the coarse grid");
  const std::initializer_list<std::size_t> same = {batch, 3, x.shape(2), x.shape(3)};
  need(shaped(v, same) && shaped(old, same), "velocities must be like positions");
  need(shaped(wind, {batch, 3}) && shaped(bodies, {batch, net.radii.size(), 2, 3}), "wind (B, 3), bodies (B, C, 2, 3)");
  nb::gil_scoped_release release;
  for (std::size_t b = 0; b < batch; ++b)
    lanes<CorrectLanes>().correct(net, old.data() + b * size,
                                  {wind.data() + 3 * b, bodies.data() + 6 * net.radii.size() * b}, x.data() + b * size,
                                  v.data() + b * size);
}

}  // namespace

void bind_correct(nb::module_& m) {
  nb::class_<Correct>(m, "Correct")
      .def("__init__", &make_correct, nb::arg("index"), nb::arg("nearer"), nb::arg("place"), nb::arg("share"),
           nb::arg("weights"), nb::arg("biases"), nb::arg("low"), nb::arg("high"), nb::arg("limit"), nb::arg("spacing"),
           nb::arg("frame_dt"), nb::arg("wind"), nb::arg("planes"), nb::arg("radii"))
      .def("apply", &apply_correct, nb::arg("old"), nb::arg("wind"), nb::arg("bodies"), nb::arg("x").noconvert(),
           nb::arg("v").noconvert(),
           "Corrects positions and velocities (B, 3, h, w) after a frame from velocities old.");
}

}  // namespace minicloth
