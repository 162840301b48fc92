// Upscaled cloth and bodies for Python.
#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "../base/arrays.hpp"
#include "../module.hpp"
#include "../sheet/sheet.hpp"
#include "core.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

// The bodies of a sheet, and the vertices that they leave alone.
struct Bodies {
  Sheet sheet;

  std::vector<UpscaledBody> at(const In<float, 4>& ends, const In<float, 4>& velocities, std::size_t member) const {
    std::vector<UpscaledBody> bodies(sheet.bodies.size());
    for (std::size_t c = 0; c < bodies.size(); ++c) {
      bodies[c].plane = sheet.bodies[c].plane, bodies[c].radius = float(sheet.bodies[c].radius + sheet.thickness);
      std::copy_n(ends.data() + (member * bodies.size() + c) * 6, 6, &bodies[c].ends[0][0]);
      std::copy_n(velocities.data() + (member * bodies.size() + c) * 6, 6, &bodies[c].velocities[0][0]);
    }
    return bodies;
  }

  void check(const Out<float, 4>& field, const In<float, 4>& ends, const In<float, 4>& velocities) const {
    const std::initializer_list<std::size_t> shape = {field.shape(0), sheet.bodies.size(), 2, 3};
    need(shaped(field, {field.shape(0), 3, std::size_t(sheet.rows), std::size_t(sheet.cols)}),
         "the cloth must be (B, 3, H, W)");
    need(shaped(ends, shape) && shaped(velocities, shape), "colliders must be (B, C, 2, 3)");
  }

  // Calls work() while the held vertices of planes (3, n) are nowhere, near no body.
  template <class Work>
  void without_held(float* planes_of, std::size_t n, const Work& work) const {
    constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();
    const std::vector<int>& held = sheet.handles;
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
            const Pushed now = lanes<ProjectionLanes>().push(body, int(n), cloth);
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
          lanes<ProjectionLanes>().stop(body, int(n), x.data() + b * 3 * n, cloth, float(reach));
      });
    }
  }
};

}  // namespace

void bind_projection(nb::module_& m) {
  nb::class_<Bodies>(m, "Bodies", "Keeps upscaled vertices but the held ones out of a scene's bodies.")
      .def(nb::init<Sheet>(), nb::arg("sheet"))
      .def("push_out", &Bodies::push_out,
           "Puts vertices of x that are in bodies on the surface; how many, and the deepest, by member.")
      .def("stop_at", &Bodies::stop_at, "Takes from vertices x at the surface the velocity v into the body.");
}

}  // namespace minicloth
