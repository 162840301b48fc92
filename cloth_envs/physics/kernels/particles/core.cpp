#include "core.hpp"

#include <utility>

#include "../base/threads.hpp"
#include "../sheet/drives.hpp"

namespace minicloth {
namespace {

// A field (3, rows, cols) and its planes in waves.
template <class T>
void spread(const Waves& waves, const T* field, Axes<T> planes) {
  for (T* plane : planes)
    for (int r = 0; r < waves.rows; ++r)
      for (int c = 0; c < waves.cols; ++c) plane[waves.at(r, c)] = *field++;
}
template <class T>
void gather(const Waves& waves, Axes<T> planes, T* field) {
  for (const T* plane : planes)
    for (int r = 0; r < waves.rows; ++r)
      for (int c = 0; c < waves.cols; ++c) *field++ = plane[waves.at(r, c)];
}

template <class T>
void advance(const Net<T>& net, const Frame<T>& f) {
  const auto& kernels = lanes<NetLanes<T>>();
  const Sheet& sheet = net.sheet;
  NetStep<T> step = net.step;
  step.pressure = T(sheet.pressure ? f.pressure : 0.0);
  const Waves& waves = step.waves;
  const int n = waves.size();
  thread_local std::vector<T> memory;
  memory.assign((net.in_place ? 6 : 9) * std::size_t(n), T(0));
  T* start = memory.data();
  T *x[3] = {start, start + n, start + 2 * n}, *v[3] = {start + 3 * n, start + 4 * n, start + 5 * n};
  T* next[3] = {v[0], v[1], v[2]};
  if (!net.in_place)
    for (int k = 0; k < 3; ++k) next[k] = start + (6 + k) * n;
  spread<T>(waves, f.x, x), spread<T>(waves, f.v, v);
  const auto handles =
      handles_of(sheet, f, 0.0, [&](int vertex) { return waves.at(vertex / sheet.cols, vertex % sheet.cols); });
  const std::vector<Cubic> paths = body_paths(sheet, f);
  std::vector<NetBall<T>> balls(sheet.bodies.size());

  for (int k = 0; k < net.substeps; ++k) {
    const double begin = double(k) / net.substeps, end = double(k + 1) / net.substeps;
    for (std::size_t b = 0; b < balls.size(); ++b) {
      balls[b].radius = T(sheet.bodies[b].radius), balls[b].keep = T(net.keep);
      for (int c = 0; c < 3; ++c) {
        const Cubic& path = paths[6 * b + c];
        balls[b].centre[c] = T(path.position(begin));
        balls[b].velocity[c] = T(path.velocity(begin) / sheet.frame_dt);
      }
    }
    kernels.velocities(step, x, v, next);
    std::swap(v, next);
    kernels.move(step, balls, x, v);
    put_positions<T>(handles, end, x), put_velocities<T>(handles, end, v);
  }
  gather<T>(waves, x, f.x_out), gather<T>(waves, v, f.v_out);
}

}  // namespace

template <class T>
void advance(const Net<T>& net, const std::vector<Frame<T>>& frames, int threads) {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(net, frames[i]); });
}
template void advance(const Net<float>&, const std::vector<Frame<float>>&, int);
template void advance(const Net<double>&, const std::vector<Frame<double>>&, int);

}  // namespace minicloth
