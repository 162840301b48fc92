// Upscaling for Python.
#include "upscale.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "arrays.hpp"
#include "resample.hpp"

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

// `finer` goes on from half the spacing, or is null where that is all.
void upscale(const PatchNet& net, In<float, 4> x, In<float, 2> bias, const Grids* finer, Out<float, 4> out) {
  const std::size_t batch = x.shape(0), rows = x.shape(2), cols = x.shape(3);
  const std::size_t high = 2 * rows - 1, wide = 2 * cols - 1;
  need(x.shape(1) == 3 && rows >= 3 && cols >= 3, "positions must be (B, 3, h, w), 3 x 3 vertices or more");
  need(!finer || (finer->h == int(high) && finer->w == int(wide)), "finer must start from (2 h - 1, 2 w - 1)");
  const std::size_t last = finer ? finer->rows.count : high, end = finer ? finer->cols.count : wide;
  need(shaped(out, {batch, 3, last, end}), "out must be (B, 3, 2 h - 1, 2 w - 1), or as finer has it");
  need(shaped(bias, {batch, std::size_t(net.biases)}), "bias must be (B, outputs of all layers)");
  nb::gil_scoped_release release;
  thread_local Plane<float> half;
  half.resize(finer ? 3 * high * wide : 0);
  for (std::size_t b = 0; b < batch; ++b) {
    float* to = out.data() + b * 3 * last * end;
    best_upscale_lanes().upscale(net, x.data() + b * 3 * rows * cols, int(rows), int(cols),
                                 bias.data() + b * net.biases, finer ? half.data() : to);
    if (finer) (*finer)(half.data(), 3, to);
  }
}

// The bodies of a scene, with its thickness, and the vertices that they leave alone.
struct Bodies {
  std::vector<float> radii;
  std::vector<bool> planes;
  std::vector<int> held;

  std::vector<UpscaledBody> at(const In<float, 4>& ends, const In<float, 4>& velocities, std::size_t member) const {
    std::vector<UpscaledBody> bodies(radii.size());
    for (std::size_t c = 0; c < bodies.size(); ++c) {
      bodies[c].plane = planes[c], bodies[c].radius = radii[c];
      std::copy_n(ends.data() + (member * bodies.size() + c) * 6, 6, &bodies[c].ends[0][0]);
      std::copy_n(velocities.data() + (member * bodies.size() + c) * 6, 6, &bodies[c].velocities[0][0]);
    }
    return bodies;
  }

  void check(const Out<float, 4>& field, const In<float, 4>& ends, const In<float, 4>& velocities) const {
    const std::initializer_list<std::size_t> shape = {field.shape(0), radii.size(), 2, 3};
    need(field.shape(1) == 3, "the cloth must be (B, 3, H, W)");
    need(shaped(ends, shape) && shaped(velocities, shape), "colliders must be (B, C, 2, 3), as many as radii");
    for (int i : held) need(i >= 0 && i < int(field.shape(2) * field.shape(3)), "a handle is not a vertex of the grid");
  }

  // Calls work() while the held vertices of planes (3, n) are nowhere, near no body.
  template <class Work>
  void without_held(float* planes_of, std::size_t n, const Work& work) const {
    constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();
    const std::size_t count = held.size();
    thread_local std::vector<float> kept;
    kept.resize(3 * count);
    for (std::size_t i = 0; i < 3 * count; ++i)
      kept[i] = std::exchange(planes_of[i / count * n + held[i % count]], nowhere);
    work();
    for (std::size_t i = 0; i < 3 * count; ++i) planes_of[i / count * n + held[i % count]] = kept[i];
  }

  // Bodies act one after the other, twice where there are several.
  void push_out(Out<float, 4> x, In<float, 4> ends, In<float, 4> velocities, Out<int, 1> pushed,
                Out<float, 1> depth) const {
    const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3);
    check(x, ends, velocities);
    need(shaped(pushed, {batch}) && shaped(depth, {batch}), "pushed and depth must be (B,)");
    nb::gil_scoped_release release;
    for (std::size_t b = 0; b < batch; ++b) {
      float* cloth = x.data() + b * 3 * n;
      int& count = pushed.data()[b] = 0;
      float& deepest = depth.data()[b] = 0;
      const auto bodies = at(ends, velocities, b);
      without_held(cloth, n, [&] {
        for (int pass = 0; pass < 2 && (pass == 0 || (count > 0 && bodies.size() > 1)); ++pass)
          for (const auto& body : bodies) {
            const Pushed now = best_upscale_lanes().push(body, int(n), cloth);
            if (pass == 0) count += now.count, deepest = std::max(deepest, now.depth);
          }
      });
    }
  }

  void stop_at(Out<float, 4> v, In<float, 4> x, In<float, 4> ends, In<float, 4> velocities, double reach) const {
    const std::size_t n = x.shape(2) * x.shape(3);
    check(v, ends, velocities);
    need(shaped(x, {v.shape(0), 3, v.shape(2), v.shape(3)}), "x and v must be of one shape");
    nb::gil_scoped_release release;
    for (std::size_t b = 0; b < x.shape(0); ++b) {
      float* cloth = v.data() + b * 3 * n;
      without_held(cloth, n, [&] {
        for (const auto& body : at(ends, velocities, b))
          best_upscale_lanes().stop(body, int(n), x.data() + b * 3 * n, cloth, float(reach));
      });
    }
  }
};

}  // namespace

void bind_upscale(nb::module_& m) {
  nb::class_<PatchNet>(m, "PatchNet")
      .def("__init__", &make_net, nb::arg("spacing"), nb::arg("limit"), nb::arg("weights"))
      .def(
          "upscale", &upscale, nb::arg("x"), nb::arg("bias"), nb::arg("finer").none(), nb::arg("out"),
          "Writes coarse positions (B, 3, h, w) at half the spacing, bicubic and residual, or what finer makes of it.");
  nb::class_<Bodies>(m, "Bodies", "Keeps upscaled vertices but the held ones out of a scene's bodies.")
      .def("__init__",
           [](Bodies* self, std::vector<float> radii, std::vector<bool> planes, std::vector<int> held) {
             need(radii.size() == planes.size(), "as many planes as radii");
             new (self) Bodies{std::move(radii), std::move(planes), std::move(held)};
           })
      .def("push_out", &Bodies::push_out,
           "Puts vertices of x that are in bodies on the surface; how many, and the deepest, by member.")
      .def("stop_at", &Bodies::stop_at, "Takes from vertices x at the surface the velocity v into the body.");
}

}  // namespace minicloth
