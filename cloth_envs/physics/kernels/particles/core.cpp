#include "core.hpp"

#include <algorithm>
#include <utility>

#include "../base/threads.hpp"
#include "../sheet/drives.hpp"

namespace minicloth {
namespace {

template <class T>
void advance(const Net<T>& net, const Frame<T>& f) {
  const auto& kernels = lanes<NetLanes<T>>();
  const Sheet& sheet = net.sheet;
  const int n = sheet.rows * sheet.cols;
  thread_local std::vector<T> memory;
  memory.resize(12 * std::size_t(n));
  T *x = memory.data(), *v = x + 3 * n, *x_next = v + 3 * n, *v_next = x_next + 3 * n;
  std::copy_n(f.x, 3 * n, x), std::copy_n(f.v, 3 * n, v);
  NetStep<T> step = net.step;
  step.pressure = T(sheet.pressure ? f.pressure : 0.0);
  const auto handles = handles_of(sheet, f, 0.0, [](int vertex) { return vertex; });
  const std::vector<Cubic> paths = body_paths(sheet, f);

  for (int k = 0; k < net.substeps; ++k) {
    const double start = double(k) / net.substeps, end = double(k + 1) / net.substeps;
    kernels.velocities(step, x, v, v_next);
    for (std::size_t b = 0; b < sheet.bodies.size(); ++b) {
      NetBall<T> ball{{}, {}, T(sheet.bodies[b].radius), T(net.keep)};
      for (int c = 0; c < 3; ++c) {
        const Cubic& path = paths[6 * b + c];
        ball.centre[c] = T(path.position(start)), ball.velocity[c] = T(path.velocity(start) / sheet.frame_dt);
      }
      kernels.ball(ball, n, x, v_next);
    }
    kernels.positions(3 * n, step.dt, x, v_next, x_next);
    put_positions(handles, end, {x_next, x_next + n, x_next + 2 * n});
    put_velocities(handles, end, {v_next, v_next + n, v_next + 2 * n});
    std::swap(x, x_next), std::swap(v, v_next);
  }
  std::copy_n(x, 3 * n, f.x_out), std::copy_n(v, 3 * n, f.v_out);
}

}  // namespace

template <class T>
void advance(const Net<T>& net, const std::vector<Frame<T>>& frames, int threads) {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(net, frames[i]); });
}
template void advance(const Net<float>&, const std::vector<Frame<float>>&, int);
template void advance(const Net<double>&, const std::vector<Frame<double>>&, int);

}  // namespace minicloth
