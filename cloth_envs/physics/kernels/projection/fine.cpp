// Fine cloths out of coarse ones, for Python: a member after the other, while its few vertices lie in the caches.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "../base/arrays.hpp"
#include "../base/threads.hpp"
#include "../episode/core.hpp"
#include "../module.hpp"
#include "../nets/patch.hpp"
#include "../nets/resample.hpp"
#include "../sheet/sheet.hpp"
#include "core.hpp"
#include "mend.hpp"
#include "separate.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

using Fields = In<float, 4>;

constexpr int kSeparations = 6;  // of folds, each after which vertices are put outside bodies again, at most

// Mends cloths of one grid, whose vertices `held` stay.
struct Mend {
  Mend(const Mending& how_, const In<int, 1>& held_) : how(how_), held(held_.data(), held_.data() + held_.size()) {
    need(how.rows >= 3 && how.cols >= 3, "a grid of 3 x 3 vertices or more");
    for (int i : held) need(i >= 0 && i < how.rows * how.cols, "a held vertex is not one of the grid");
  }
  void operator()(float* x) const { lanes<MendLanes>().mend(how, held.data(), held.size(), x); }
  bool fits(std::size_t rows, std::size_t cols) const { return how.rows == int(rows) && how.cols == int(cols); }

  Mending how;
  std::vector<int> held;
};

class Fine {
 public:
  Fine(Sheet sheet, In<int, 1> firm, In<int, 1> near, In<int, 1> guides, In<float, 1> pull, double rounding,
       double reach)
      : sheet_(std::move(sheet)),
        firm_(firm.data(), firm.data() + firm.size()),
        near_(near.data(), near.data() + near.size()),
        guides_(guides.data(), guides.data() + guides.size()),
        pull_(pull.data(), pull.data() + pull.size()),
        rounding_(rounding),
        reach_(float(reach)) {
    need(guides_.size() == near_.size() && pull_.size() == near_.size(), "as many guides and pulls as near");
    const int n = sheet_.rows * sheet_.cols;
    for (int i : firm_) need(i >= 0 && i < int(sheet_.handles.size()), "no such handle");
    for (int i : firm_) held_.push_back(sheet_.handles[i]);
    for (int i : near_) need(i >= 0 && i < n, "a near vertex is not one of the grid");
    for (int i : guides_) need(i >= 0 && i < int(held_.size()), "no such guide");
  }

  // Fills x and v (B, 3, H, W). `between` mends at the half spacing that a network gives, `mend` at the end. `guard` is
  // the strain above which positions are interpolated by `cubic` instead, and above which `mend_more` mends these too.
  void fill(Fields coarse_x, Fields coarse_v, const PatchNet* net, In<float, 2> bias, const Grids* grids,
            const Grids* speeds, const Mend* between, const Mend* mend, const Grids* cubic, const Mend* mend_cubic,
            const Mend* mend_more, double guard, In<double, 3> driven_x, In<double, 3> driven_v, Fields ends,
            Fields velocities, Out<float, 4> x, Out<float, 4> v, Out<int, 1> pushed, Out<float, 1> depth,
            Out<int, 1> guarded, int threads) const {
    const std::size_t batch = x.shape(0), rows = sheet_.rows, cols = sheet_.cols, held = sheet_.handles.size();
    const std::size_t h = coarse_x.shape(2), w = coarse_x.shape(3), n = 3 * rows * cols, few = 3 * h * w;
    const std::initializer_list<std::size_t> cloth = {batch, 3, rows, cols}, driven = {batch, held, 3},
                                             bodies = {batch, sheet_.bodies.size(), 2, 3};
    need(shaped(x, cloth) && shaped(v, cloth), "x and v must be (B, 3, H, W)");
    need(shaped(coarse_x, {batch, 3, h, w}) && shaped(coarse_v, {batch, 3, h, w}),
         "coarse fields must be (B, 3, h, w)");
    need(shaped(driven_x, driven) && shaped(driven_v, driven), "driven must be (B, N, 3)");
    need(shaped(ends, bodies) && shaped(velocities, bodies), "colliders must be (B, C, 2, 3)");
    need(shaped(pushed, {batch}) && shaped(depth, {batch}) && shaped(guarded, {batch}), "what is told must be (B,)");
    need(!net || (bias.shape(0) >= batch && bias.shape(1) == std::size_t(net->biases) && h >= 3 && w >= 3),
         "a network needs 3 x 3 vertices or more and its biases (B, n)");
    need(!net || grids || (rows == 2 * h - 1 && cols == 2 * w - 1), "a network gives half the spacing");
    for (const Grids* each : {net ? nullptr : grids, speeds, cubic})
      need(!each || (each->h == int(h) && each->w == int(w)), "interpolation must start from the coarse grid");
    need(!net || !grids || (grids->h == int(2 * h - 1) && grids->w == int(2 * w - 1)),
         "interpolation after a network must start from half the spacing");
    for (const Grids* each : {grids, speeds, cubic})
      need(!each || (each->rows.count == int(rows) && each->cols.count == int(cols)), "interpolation to another grid");
    for (const Mend* each : {mend, mend_cubic, mend_more})
      need(!each || each->fits(rows, cols), "what mends is for another grid");
    need(!between || (net && grids && between->fits(2 * h - 1, 2 * w - 1)),
         "what mends between is for half the spacing");
    nb::gil_scoped_release release;
    for_each_member(batch, threads, [&](std::size_t b) {
      float *const at = x.data() + b * n, *const speed = v.data() + b * n;
      const float *from = coarse_x.data() + b * few, *moving = coarse_v.data() + b * few;
      const double* there = driven_x.data() + b * 3 * held;
      const std::size_t first = b * sheet_.bodies.size() * 6;
      const auto met = bodies_at(ends.data() + first, velocities.data() + first);
      const auto finish = [&](const Mend* mends) {
        put(at, there);
        if (mends) (*mends)(at);
        const Pushed found = push_out(at, met);
        pushed.data()[b] = found.count, depth.data()[b] = found.depth;
      };
      thread_local std::vector<float> half;
      if (between) {
        half.resize(3 * (2 * h - 1) * (2 * w - 1));
        upscale(*net, from, int(h), int(w), bias.data() + b * net->biases, nullptr, half.data());
        (*between)(half.data()), (*grids)(half.data(), 3, at);
      } else if (net)
        upscale(*net, from, int(h), int(w), bias.data() + b * net->biases, grids, at);
      else if (grids)
        (*grids)(from, 3, at);
      finish(mend);
      guarded.data()[b] = cubic && !(strain(at) <= guard);
      if (guarded.data()[b]) {
        (*cubic)(from, 3, at), finish(mend_cubic);
        if (mend_more && !(strain(at) <= guard)) finish(mend_more);
      }
      const auto settle = [&](float* cloth) { put(cloth, there), push_out(cloth, met); };
      const Held stay = {held_, settle};
      const bool folds = sheet_.self_thickness > 0;
      for (int round = 0; folds && round < kSeparations && separate(sheet_, stay, from, int(h), int(w), at, round > 0);
           ++round)
        settle(at);
      if (speeds) (*speeds)(moving, 3, speed);
      put(speed, driven_v.data() + b * 3 * held);
      stop_at(speed, at, met);
    });
  }

 private:
  void put(float* field, const double* driven) const {
    const Pulled pulled = {near_.data(), guides_.data(), pull_.data(), near_.size()};
    place(field, std::size_t(sheet_.rows) * sheet_.cols, driven, firm_.data(), held_.data(), held_.size(), pulled,
          rounding_);
  }

  // Of the longest structural edge, NaN of a cloth that is not finite.
  double strain(const float* x) const {
    const Check found = lanes<StateLanes<float>>().check(x, x, sheet_.rows, sheet_.cols, float(sheet_.row_length),
                                                         float(sheet_.col_length), sheet_.periodic);
    return found.finite ? found.strain : std::numeric_limits<double>::quiet_NaN();
  }

  std::vector<UpscaledBody> bodies_at(const float* ends, const float* velocities) const {
    std::vector<UpscaledBody> bodies(sheet_.bodies.size());
    for (std::size_t c = 0; c < bodies.size(); ++c) {
      bodies[c].plane = sheet_.bodies[c].plane, bodies[c].radius = float(sheet_.bodies[c].radius + sheet_.thickness);
      std::copy_n(ends + 6 * c, 6, &bodies[c].ends[0][0]);
      std::copy_n(velocities + 6 * c, 6, &bodies[c].velocities[0][0]);
    }
    return bodies;
  }

  // Calls work() while the held vertices of a field (3, n) are nowhere, near no body.
  template <class Work>
  void without_held(float* field, const Work& work) const {
    constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();
    const std::size_t count = held_.size(), n = std::size_t(sheet_.rows) * sheet_.cols;
    thread_local std::vector<float> memory;
    memory.resize(3 * count);
    float* const kept = memory.data();
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t i = 0; i < count; ++i) kept[k * count + i] = std::exchange(field[k * n + held_[i]], nowhere);
    work();
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t i = 0; i < count; ++i) field[k * n + held_[i]] = kept[k * count + i];
  }

  Pushed push_out(float* x, const std::vector<UpscaledBody>& bodies) const {
    Pushed all = {0, 0};
    without_held(x, [&] { all = lanes<ProjectionLanes>().push(bodies, sheet_.rows * sheet_.cols, x); });
    return all;
  }

  void stop_at(float* v, const float* x, const std::vector<UpscaledBody>& bodies) const {
    without_held(v, [&] { lanes<ProjectionLanes>().stop(bodies, sheet_.rows * sheet_.cols, x, v, reach_); });
  }

  Sheet sheet_;
  std::vector<int> firm_, held_, near_, guides_;  // firm_ are the numbers of the handles held_
  std::vector<float> pull_;
  double rounding_;
  float reach_;
};

}  // namespace

void bind_fine(nb::module_& m) {
  nb::class_<Mend>(m, "Mend", "Brings the edges of cloths to their lengths: surrogates/miniature/mending.py.")
      .def(
          "__init__",
          [](Mend* self, int rows, int cols, double row_length, double col_length, In<int, 1> held, int sweeps,
             double slack, double shorter, double wave, double buckling) {
            const Mending how = {rows,         cols,           sweeps,      float(row_length), float(col_length),
                                 float(slack), float(shorter), float(wave), float(buckling)};
            new (self) Mend(how, held);
          },
          nb::arg("rows"), nb::arg("cols"), nb::arg("row_length"), nb::arg("col_length"), nb::arg("held"),
          nb::arg("sweeps"), nb::arg("slack"), nb::arg("shorter"), nb::arg("wave"), nb::arg("buckling"))
      .def(
          "apply",
          [](const Mend& mend, Out<float, 4> x) {
            const std::size_t rows = mend.how.rows, cols = mend.how.cols;
            need(shaped(x, {x.shape(0), 3, rows, cols}), "positions must be (B, 3, H, W)");
            for (std::size_t b = 0; b < x.shape(0); ++b) mend(x.data() + b * 3 * rows * cols);
          },
          nb::arg("x"), "Mends positions (B, 3, H, W) in place.");
  nb::class_<Fine>(m, "Fine", "Makes fine cloths out of coarse ones: upscaled, driven, outside all bodies.")
      .def(nb::init<Sheet, In<int, 1>, In<int, 1>, In<int, 1>, In<float, 1>, double, double>(), nb::arg("sheet"),
           nb::arg("firm"), nb::arg("near"), nb::arg("guides"), nb::arg("pull"), nb::arg("rounding"), nb::arg("reach"))
      .def("fill", &Fine::fill, nb::arg("coarse_x"), nb::arg("coarse_v"), nb::arg("net").none(), nb::arg("bias"),
           nb::arg("grids").none(), nb::arg("speeds").none(), nb::arg("between").none(), nb::arg("mend").none(),
           nb::arg("cubic").none(), nb::arg("mend_cubic").none(), nb::arg("mend_more").none(), nb::arg("guard"),
           nb::arg("driven_x"), nb::arg("driven_v"), nb::arg("ends"), nb::arg("velocities"), nb::arg("x"), nb::arg("v"),
           nb::arg("pushed"), nb::arg("depth"), nb::arg("guarded"), nb::arg("threads"), "Fills x and v (B, 3, H, W).");
}

}  // namespace minicloth
