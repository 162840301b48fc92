// Super-resolution for Python.
#include "detail.hpp"

#include <nanobind/stl/vector.h>

#include <utility>

#include "../base/arrays.hpp"
#include "../base/threads.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

void make_detail_net(DetailNet* self, int rows, int cols, bool periodic, double spacing, double limit, double reach,
                     In<float, 1> mean, In<float, 1> per, In<float, 2> held, In<float, 1> radii,
                     const std::vector<bool>& planes, const std::vector<In<float, 2>>& weights,
                     const std::vector<In<float, 1>>& biases, const Grids& finer) {
  need(rows >= 3 && cols >= 3 && spacing > 0 && limit > 0 && reach > 0,
       "3 x 3 vertices or more; spacing, limit and reach positive");
  need(shaped(mean, {kChannels}) && shaped(per, {kChannels}), "mean and per must be (41,)");
  need(shaped(held, {std::size_t(rows), std::size_t(cols)}), "held must be (rows, cols)");
  need(!weights.empty() && weights.size() == biases.size(), "as many biases as weights, one or more");
  need(shaped(radii, {planes.size()}), "as many radii as planes, one of every body");
  DetailNet net{rows, cols, periodic, float(spacing), float(limit), float(reach), {}, {}, {},
                {},   {},   {},       planes,         finer};
  const auto copy = [](const float* from, std::size_t count) { return Plane<float>(from, from + count); };
  net.mean = copy(mean.data(), kChannels), net.per = copy(per.data(), kChannels);
  net.held = copy(held.data(), held.size()), net.radii = copy(radii.data(), planes.size());
  int inputs = kChannels;
  for (std::size_t l = 0; l < weights.size(); ++l) {
    const int outputs = int(weights[l].shape(0));
    need(int(weights[l].shape(1)) == kTaps9 * inputs && shaped(biases[l], {std::size_t(outputs)}),
         "weights must be (out, 9 in), biases (out,)");
    need(outputs % 4 == 0 && outputs <= kWidest, "a layer must have 4, 8, ... 256 channels");
    net.layers.emplace_back(weights[l].data(), outputs, kTaps9 * inputs);
    net.biases.push_back(copy(biases[l].data(), outputs));
    inputs = outputs;
  }
  need(inputs == 3 * kScale * kScale, "the last layer must have 48 outputs");
  need(finer.h == rows && finer.w == cols && finer.rows.count == net.fine_rows() && finer.cols.count == net.fine_cols(),
       "finer must lead to a quarter of the spacing");
  new (self) DetailNet(std::move(net));
}

void add_all(const DetailNet& net, In<float, 4> now, In<float, 4> before, In<float, 4> earlier, In<float, 4> bodies,
             In<float, 4> bodies_before, Out<float, 4> fine, int threads) {
  const std::size_t batch = now.shape(0), coarse = 3 * std::size_t(net.rows) * net.cols;
  const std::size_t high = net.fine_rows(), wide = net.fine_cols();
  for (const auto* x : {&now, &before, &earlier})
    need(shaped(*x, {batch, 3, std::size_t(net.rows), std::size_t(net.cols)}), "positions must be (B, 3, h, w)");
  const std::size_t around = net.planes.size();
  for (const auto* ends : {&bodies, &bodies_before})
    need(shaped(*ends, {batch, around, 2, 3}), "bodies must be (B, C, 2, 3)");
  need(shaped(fine, {batch, 3, high, wide}), "fine must be (B, 3, H, W)");
  nb::gil_scoped_release release;
  for_each_member(batch, threads, [&](std::size_t b) {
    lanes<DetailLanes>().add(net, now.data() + b * coarse, before.data() + b * coarse, earlier.data() + b * coarse,
                             bodies.data() + b * around * 6, bodies_before.data() + b * around * 6,
                             fine.data() + b * 3 * high * wide);
  });
}

}  // namespace

void bind_detail(nb::module_& m) {
  nb::class_<DetailNet>(m, "DetailNet", "Detail of a fine cloth: surrogates/superres/network.py.")
      .def("__init__", &make_detail_net, nb::arg("rows"), nb::arg("cols"), nb::arg("periodic"), nb::arg("spacing"),
           nb::arg("limit"), nb::arg("reach"), nb::arg("mean"), nb::arg("per"), nb::arg("held"), nb::arg("radii"),
           nb::arg("planes"), nb::arg("weights"), nb::arg("biases"), nb::arg("finer"))
      .def("add", &add_all, nb::arg("now"), nb::arg("before"), nb::arg("earlier"), nb::arg("bodies"),
           nb::arg("bodies_before"), nb::arg("fine").noconvert(), nb::arg("threads"),
           "Adds to fine positions (B, 3, H, W) what coarse ones (B, 3, h, w) tell of detail.");
}

}  // namespace minicloth
