// Upscaling for Python.
#include "upscale.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "arrays.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

void make_net(PatchNet* self, double spacing, double limit, const std::vector<In<float, 2>>& weights) {
  need(spacing > 0 && limit > 0, "spacing and limit must be positive");
  PatchNet net{float(spacing), float(limit), {}, 0};
  int inputs = 3 * kPoints;
  for (const auto& w : weights) {
    const int outputs = int(w.shape(0)), blocks = (outputs + kUnits - 1) / kUnits;
    need(int(w.shape(1)) == inputs && outputs <= kWidest, "weights must be (out, in), from 36, at most 256");
    DenseLayer layer{inputs, outputs, Plane<float>(std::size_t(blocks) * inputs * kUnits, 0.0f)};
    for (int j = 0; j < outputs; ++j)
      for (int f = 0; f < inputs; ++f)
        layer.weights[(std::size_t(j / kUnits) * inputs + f) * kUnits + j % kUnits] = w.data()[j * inputs + f];
    net.layers.push_back(std::move(layer));
    net.biases += outputs;
    inputs = outputs;
  }
  need(inputs == 3 * kNodes, "the last layer must have 27 outputs");
  new (self) PatchNet(std::move(net));
}

void upscale(const PatchNet& net, In<float, 4> x, In<float, 2> bias, Out<float, 4> out) {
  const std::size_t batch = x.shape(0), rows = x.shape(2), cols = x.shape(3);
  const std::size_t high = 2 * rows - 1, wide = 2 * cols - 1;
  need(x.shape(1) == 3 && rows >= 3 && cols >= 3, "positions must be (B, 3, h, w), 3 x 3 vertices or more");
  need(shaped(out, {batch, 3, high, wide}), "out must be (B, 3, 2 h - 1, 2 w - 1)");
  need(shaped(bias, {batch, std::size_t(net.biases)}), "bias must be (B, outputs of all layers)");
  nb::gil_scoped_release release;
  for (std::size_t b = 0; b < batch; ++b)
    best_upscale_lanes().upscale(net, x.data() + b * 3 * rows * cols, int(rows), int(cols),
                                 bias.data() + b * net.biases, out.data() + b * 3 * high * wide);
}

std::vector<UpscaledBody> bodies_of(In<float, 4> ends, In<float, 4> velocities, In<float, 1> radii,
                                    const std::vector<bool>& planes, std::size_t member) {
  const std::size_t count = radii.shape(0);
  std::vector<UpscaledBody> bodies(count);
  for (std::size_t c = 0; c < count; ++c) {
    bodies[c].plane = planes[c], bodies[c].radius = radii.data()[c];
    std::copy_n(ends.data() + (member * count + c) * 6, 6, &bodies[c].ends[0][0]);
    std::copy_n(velocities.data() + (member * count + c) * 6, 6, &bodies[c].velocities[0][0]);
  }
  return bodies;
}

void check_bodies(std::size_t batch, In<float, 4> ends, In<float, 4> velocities, In<float, 1> radii,
                  const std::vector<bool>& planes) {
  const std::initializer_list<std::size_t> shape = {batch, radii.shape(0), 2, 3};
  need(shaped(ends, shape) && shaped(velocities, shape) && planes.size() == radii.shape(0),
       "colliders must be (B, C, 2, 3), as many as radii and planes");
}

constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();  // held vertices meanwhile: near no body

// Bodies act one after the other, twice where there are several.
void push_out(Out<float, 4> x, In<float, 4> ends, In<float, 4> velocities, In<float, 1> radii,
              const std::vector<bool>& planes, In<int, 1> held, Out<int, 1> pushed, Out<float, 1> depth) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = held.shape(0);
  need(x.shape(1) == 3 && shaped(pushed, {batch}) && shaped(depth, {batch}), "x must be (B, 3, H, W), counts (B,)");
  check_bodies(batch, ends, velocities, radii, planes);
  nb::gil_scoped_release release;
  std::vector<float> kept(3 * count);
  for (std::size_t b = 0; b < batch; ++b) {
    float* cloth = x.data() + b * 3 * n;
    pushed.data()[b] = 0, depth.data()[b] = 0;
    for (std::size_t i = 0; i < 3 * count; ++i)
      kept[i] = std::exchange(cloth[i / count * n + held.data()[i % count]], nowhere);
    const auto bodies = bodies_of(ends, velocities, radii, planes, b);
    for (int pass = 0; pass < 2 && (pass == 0 || (pushed.data()[b] > 0 && bodies.size() > 1)); ++pass)
      for (const auto& body : bodies) {
        const Pushed now = best_upscale_lanes().push(body, int(n), cloth);
        if (pass == 0) pushed.data()[b] += now.count, depth.data()[b] = std::max(depth.data()[b], now.depth);
      }
    for (std::size_t i = 0; i < 3 * count; ++i) cloth[i / count * n + held.data()[i % count]] = kept[i];
  }
}

void stop_at(Out<float, 4> v, In<float, 4> x, In<float, 4> ends, In<float, 4> velocities, In<float, 1> radii,
             const std::vector<bool>& planes, In<int, 1> held, double reach) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = held.shape(0);
  need(x.shape(1) == 3 && shaped(v, {batch, 3, x.shape(2), x.shape(3)}), "x and v must be (B, 3, H, W)");
  check_bodies(batch, ends, velocities, radii, planes);
  nb::gil_scoped_release release;
  std::vector<float> kept(3 * count);
  for (std::size_t b = 0; b < batch; ++b) {
    float* cloth = v.data() + b * 3 * n;
    for (std::size_t i = 0; i < 3 * count; ++i)
      kept[i] = std::exchange(cloth[i / count * n + held.data()[i % count]], nowhere);
    for (const auto& body : bodies_of(ends, velocities, radii, planes, b))
      best_upscale_lanes().stop(body, int(n), x.data() + b * 3 * n, cloth, float(reach));
    for (std::size_t i = 0; i < 3 * count; ++i) cloth[i / count * n + held.data()[i % count]] = kept[i];
  }
}

}  // namespace

void bind_upscale(nb::module_& m) {
  nb::class_<PatchNet>(m, "PatchNet")
      .def("__init__", &make_net, nb::arg("spacing"), nb::arg("limit"), nb::arg("weights"))
      .def("upscale", &upscale,
           "Writes coarse positions (B, 3, h, w) at half the spacing, bicubic and residual, to out.");
  m.def("push_out", &push_out, nb::arg("x").noconvert(), nb::arg("ends"), nb::arg("velocities"), nb::arg("radii"),
        nb::arg("planes"), nb::arg("held"), nb::arg("pushed").noconvert(), nb::arg("depth").noconvert(),
        "Puts vertices that are in bodies on the surface; how many, and the deepest, by member.");
  m.def("stop_at", &stop_at, nb::arg("v").noconvert(), nb::arg("x"), nb::arg("ends"), nb::arg("velocities"),
        nb::arg("radii"), nb::arg("planes"), nb::arg("held"), nb::arg("reach"),
        "Takes from vertices at the surface of bodies the velocity into them.");
}

}  // namespace minicloth
