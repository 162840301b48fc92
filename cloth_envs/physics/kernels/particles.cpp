#include "particles.hpp"

#include <utility>

#include "frames.hpp"

namespace minicloth {
namespace {

template <class T>
void advance(const Net<T>& net, const NetFrame<T>& f) {
  const NetLanes<T>& lanes = best_net_lanes<T>();
  const int n = net.step.rows * net.step.cols;
  thread_local std::vector<T> memory;
  memory.resize(12 * std::size_t(n));
  T *x = memory.data(), *v = x + 3 * n, *x_next = v + 3 * n, *v_next = x_next + 3 * n;
  std::copy_n(f.x, 3 * n, x), std::copy_n(f.v, 3 * n, v);
  NetStep<T> step = net.step;
  step.pressure = T(f.pressure);

  std::vector<Driven> handles(net.handles.size());
  for (std::size_t h = 0; h < handles.size(); ++h) {
    handles[h] = {net.handles[h], false, {}};
    for (int k = 0; k < 3; ++k) {
      const int i = k * n + net.handles[h];
      const Cubic path = {f.x[i], f.v[i] * net.frame_dt, f.handle_x[3 * h + k], f.handle_v[3 * h + k] * net.frame_dt};
      handles[h].path[k] = path;
      handles[h].moves |= path.p0 != path.p1 || path.v0 != 0 || path.v1 != 0;
    }
  }
  for (int k = 0; k < net.substeps; ++k) {
    const double s0 = double(k) / net.substeps, s1 = double(k + 1) / net.substeps;
    lanes.velocities(step, x, v, v_next);
    for (std::size_t b = 0; b < net.radii.size(); ++b) {
      NetBall<T> ball{{}, {}, T(net.radii[b]), T(net.keep)};
      for (int c = 0; c < 3; ++c) {
        const std::size_t i = 6 * b + c;
        const Cubic path = {f.body_x[i], f.body_v[i] * net.frame_dt, f.body_x_end[i], f.body_v_end[i] * net.frame_dt};
        ball.centre[c] = T(path.position(s0)), ball.velocity[c] = T(path.velocity(s0) / net.frame_dt);
      }
      lanes.ball(ball, n, x, v_next);
    }
    lanes.positions(3 * n, step.dt, x, v_next, x_next);
    for (const Driven& h : handles)
      for (int c = 0; c < 3; ++c) {
        const Cubic& path = h.path[c];
        x_next[c * n + h.index] = T(h.moves ? path.position(s1) : path.p0);
        v_next[c * n + h.index] = T(h.moves ? path.velocity(s1) / net.frame_dt : 0.0);
      }
    std::swap(x, x_next), std::swap(v, v_next);
  }
  std::copy_n(x, 3 * n, f.x_out), std::copy_n(v, 3 * n, f.v_out);
}

}  // namespace

template <class T>
void advance(const Net<T>& net, const std::vector<NetFrame<T>>& frames, int threads) {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(net, frames[i]); });
}
template void advance(const Net<float>&, const std::vector<NetFrame<float>>&, int);
template void advance(const Net<double>&, const std::vector<NetFrame<double>>&, int);

}  // namespace minicloth
