// Upscaling for Python.
#include "patch.hpp"

#include <nanobind/stl/vector.h>

#include <utility>

#include "../base/arrays.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

void make_patch_net(PatchNet* self, double spacing, double limit, const std::vector<In<float, 2>>& weights) {
  need(spacing > 0 && limit > 0, "spacing and limit must be positive");
  PatchNet net{float(spacing), float(limit), {}, 0};
  int inputs = 3 * kPoints;
  for (const auto& w : weights) {
    const int outputs = int(w.shape(0));
    need(int(w.shape(1)) == inputs, "weights must be (out, in), from 36");
    net.layers.emplace_back(w.data(), outputs, inputs);
    need(net.layers.back().fits(), "a layer may have 252 numbers");
    net.biases += outputs;
    inputs = outputs;
  }
  need(inputs == 3 * kNodes, "the last layer must have 27 outputs");
  new (self) PatchNet(std::move(net));
}

// `finer` goes on from half the spacing, or is null where that is all.
void upscale_all(const PatchNet& net, In<float, 4> x, In<float, 2> bias, const Grids* finer, Out<float, 4> out) {
  const std::size_t batch = x.shape(0), rows = x.shape(2), cols = x.shape(3);
  const std::size_t high = 2 * rows - 1, wide = 2 * cols - 1;
  need(x.shape(1) == 3 && rows >= 3 && cols >= 3, "positions must be (B, 3, h, w), 3 x 3 vertices or more");
  need(!finer || (finer->h == int(high) && finer->w == int(wide)), "finer must start from (2 h - 1, 2 w - 1)");
  const std::size_t last = finer ? finer->rows.count : high, end = finer ? finer->cols.count : wide;
  need(shaped(out, {batch, 3, last, end}), "out must be (B, 3, 2 h - 1, 2 w - 1), or as finer has it");
  need(shaped(bias, {batch, std::size_t(net.biases)}), "bias must be (B, outputs of all layers)");
  nb::gil_scoped_release release;
  for (std::size_t b = 0; b < batch; ++b)
    upscale(net, x.data() + b * 3 * rows * cols, int(rows), int(cols), bias.data() + b * net.biases, finer,
            out.data() + b * 3 * last * end);
}

}  // namespace

void upscale(const PatchNet& net, const float* x, int rows, int cols, const float* bias, const Grids* finer,
             float* out) {
  thread_local Plane<float> half;
  half.resize(finer ? 3 * std::size_t(2 * rows - 1) * (2 * cols - 1) : 0);
  lanes<PatchLanes>().upscale(net, x, rows, cols, bias, finer ? half.data() : out);
  if (finer) (*finer)(half.data(), 3, out);
}

void bind_patch(nb::module_& m) {
  nb::class_<PatchNet>(m, "PatchNet")
      .def("__init__", &make_patch_net, nb::arg("spacing"), nb::arg("limit"), nb::arg("weights"))
      .def(
          "upscale", &upscale_all, nb::arg("x"), nb::arg("bias"), nb::arg("finer").none(), nb::arg("out"),
          "Writes coarse positions (B, 3, h, w) at half the spacing, bicubic and residual, or what finer makes of it.");
}

}  // namespace minicloth
