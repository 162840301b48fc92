// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cmath>

#include "../base/simd.hpp"
#include "detail.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;
constexpr int kAcross = 3;  // vectors of pixels that are summed at a time

// Images of many channels on the coarse grid with one pixel more all around; what loops write beyond an image's end
// lies before the next one.
struct Images {
  int rows, cols, stride, first, last;
  std::size_t plane;
  bool periodic;

  explicit Images(const DetailNet& net)
      : rows(net.rows),
        cols(net.cols),
        stride(net.cols + 2),
        first(stride + 1),
        last(first + (rows - 1) * stride + cols),
        plane(std::size_t(padded((rows + 2) * stride + stride + 1 + kAcross * kBlock))),
        periodic(net.periodic) {}
  int at(int r, int c) const { return first + r * stride + c; }

  // Around every image there is 0, beside a tube's what is on the other side of the seam.
  void border(float* images, int channels) const {
    for (int k = 0; k < channels; ++k, images += plane) {
      std::fill_n(images, stride, 0.0f);
      std::fill(images + (rows + 1) * stride, images + plane, 0.0f);
      for (int r = 0; r < rows; ++r) {
        float* line = images + at(r, 0);
        line[-1] = periodic ? line[cols - 1] : 0.0f, line[cols] = periodic ? line[0] : 0.0f;
      }
    }
  }
};

// out = W * in + b, and 0 where that is negative if kCut.
template <bool kCut>
void convolve(const Images& grid, const DenseLayer<4>& layer, const float* bias, const float* in, float* out) {
  const int inputs = layer.inputs / kTaps9;
  const float* weights = layer.weights.data();
  for (int j = 0; j < layer.outputs; j += 4, weights += 4 * layer.inputs, out += 4 * grid.plane)
    for (int p = grid.first; p < grid.last; p += kAcross * kWide) {
      F sum[4][kAcross];
#pragma GCC unroll 4
      for (int k = 0; k < 4; ++k)
#pragma GCC unroll 3
        for (int a = 0; a < kAcross; ++a) sum[k][a] = F{} + bias[j + k];
      const float *w = weights, *from = in + p;
      for (int f = 0; f < inputs; ++f, from += grid.plane)
        for (int row = -1; row <= 1; ++row)
          for (int col = -1; col <= 1; ++col, w += 4) {
            const float* tap = from + row * grid.stride + col;
            F x[kAcross];
#pragma GCC unroll 3
            for (int a = 0; a < kAcross; ++a) x[a] = load(tap + a * kWide);
#pragma GCC unroll 4
            for (int k = 0; k < 4; ++k)
#pragma GCC unroll 3
              for (int a = 0; a < kAcross; ++a) sum[k][a] += w[k] * x[a];
          }
#pragma GCC unroll 4
      for (int k = 0; k < 4; ++k)
#pragma GCC unroll 3
        for (int a = 0; a < kAcross; ++a) {
          const F value = sum[k][a];
          store(out + k * grid.plane + p + a * kWide, kCut ? (value > 0.0f ? value : F{}) : value);
        }
    }
}

struct Vec {
  float x, y, z;
  Vec operator-(const Vec& o) const { return {x - o.x, y - o.y, z - o.z}; }
  Vec operator+(const Vec& o) const { return {x + o.x, y + o.y, z + o.z}; }
  Vec operator*(float s) const { return {x * s, y * s, z * s}; }
  float dot(const Vec& o) const { return x * o.x + (y * o.y + z * o.z); }
  Vec cross(const Vec& o) const { return {y * o.z - z * o.y, z * o.x - x * o.z, x * o.y - y * o.x}; }
  Vec unit() const {
    const float per = 1.0f / std::sqrt(dot(*this) + 1e-20f);
    return {per * x, per * y, per * z};
  }
};

// How near the nearest body is to a vertex; its normal there, and what the vertex slid along it in the last frame.
struct Touch {
  float near;
  Vec normal, slide;
};

// Of a vertex that moved by step, among bodies (C, 2, 3) now and a frame before.
Touch touched(const DetailNet& net, const Vec& here, const Vec& step, const float* bodies, const float* before) {
  const float reach = net.reach * net.spacing;
  float gap = reach;
  Touch touch{0.0f, {0, 0, 0}, {0, 0, 0}};
  for (std::size_t k = 0; k < net.radii.size(); ++k, bodies += 6, before += 6) {
    const Vec end{bodies[0], bodies[1], bodies[2]}, other{bodies[3], bodies[4], bodies[5]};
    const Vec old{before[0], before[1], before[2]}, old_other{before[3], before[4], before[5]};
    Vec moved = end - old, out = other;
    float away;
    if (net.planes[k]) {
      away = out.dot(here - end);
    } else {
      const Vec axis = other - end;
      const float square = axis.dot(axis);
      const float place = std::clamp((here - end).dot(axis) / (square > 0 ? square : 1.0f), 0.0f, 1.0f);
      moved = moved + (axis - (old_other - old)) * place;
      const Vec off = (here - end) - axis * place;
      away = std::sqrt(off.dot(off) + 1e-20f);
      out = off * (1.0f / away);
    }
    away -= net.radii[k];
    if (away < gap) gap = away, touch.normal = out, touch.slide = step - moved;
  }
  touch.near = 1.0f - gap / reach;
  return touch;
}

// The normalised channels, and the axes (9, rows, cols).
void read(const DetailNet& net, const Images& grid, const float* now, const float* before, const float* earlier,
          const float* bodies, const float* bodies_before, float* images, float* turn) {
  const int rows = net.rows, cols = net.cols, n = rows * cols;
  const float per = 1.0f / net.spacing;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) {
      const int i = r * cols + c;
      const int right = c + 1 < cols ? i + 1 : net.periodic ? r * cols : i;
      const int left = c > 0 ? i - 1 : net.periodic ? r * cols + cols - 1 : i;
      const int near[4] = {right, left, r + 1 < rows ? i + cols : i, r > 0 ? i - cols : i};
      const auto vertex = [n](const float* x, int at) { return Vec{x[at], x[at + n], x[at + 2 * n]}; };
      const Vec here = vertex(now, i), old = vertex(before, i), step = here - old;
      Vec x[4];
      for (int k = 0; k < 4; ++k) x[k] = vertex(now, near[k]);
      const Vec first = (x[0] - x[1]).unit(), third = (x[2] - x[3]).cross(first).unit();
      const Vec axes[3] = {first, third.cross(first), third};
      float* to = images + grid.at(r, c);
      int channel = 0;
      const auto put = [&](float value) {
        *to = (value - net.mean[channel]) * net.per[channel], ++channel, to += grid.plane;
      };
      const auto seen = [&](const Vec& a) {
        for (const Vec& axis : axes) put(per * axis.dot(a));
      };
      for (int k = 0; k < 4; ++k) seen(x[k] - here);
      for (int k = 0; k < 4; ++k) seen((x[k] - vertex(before, near[k])) - step);
      seen(step), seen(step - (old - vertex(earlier, i)));
      for (const Vec& axis : axes) put(-axis.z);
      const Touch touch = touched(net, here, step, bodies, bodies_before);
      seen(touch.normal * (net.spacing * touch.near)), seen(touch.slide * touch.near);
      put(net.held[i]), put(touch.near);
      for (int k = 0; k < 3; ++k) {
        float* line = turn + 3 * k * n + i;
        line[0] = axes[k].x, line[n] = axes[k].y, line[2 * n] = axes[k].z;
      }
    }
  grid.border(images, kChannels);
}

// The outputs of tiles of kScale x kScale pixels around coarse vertices as fine images (3, H, W).
void untile(const DetailNet& net, const Images& grid, const float* tiles, float* fine) {
  const int high = net.fine_rows(), wide = net.fine_cols();
  for (int k = 0; k < 3; ++k)
    for (int y = 0; y < high; ++y, fine += wide) {
      const int row = (y + 1) / kScale, down = (y + 1) % kScale;
      for (int across = 0; across < kScale; ++across) {
        const float* line = tiles + ((k * kScale + down) * kScale + across) * grid.plane + grid.at(row, 0);
        for (int c = 0, x = across - 1; c < net.cols; ++c, x += kScale)
          if (x >= 0 && x < wide)
            fine[x] = line[c];
          else if (net.periodic)
            fine[x + wide] = line[c];
      }
    }
}

void add(const DetailNet& net, const float* now, const float* before, const float* earlier, const float* bodies,
         const float* bodies_before, float* fine) {
  const Images grid(net);
  int widest = kChannels;
  for (const auto& layer : net.layers) widest = std::max(widest, layer.outputs);
  const int n = net.rows * net.cols, all = net.fine_rows() * net.fine_cols();
  thread_local Plane<float> first, second, turn, turns, said;
  first.resize(widest * grid.plane), second.resize(widest * grid.plane), turn.resize(9 * n);
  turns.resize(9 * std::size_t(all) + kBlock), said.resize(3 * std::size_t(all) + kBlock);
  float *in = first.data(), *out = second.data();
  read(net, grid, now, before, earlier, bodies, bodies_before, in, turn.data());
  for (std::size_t l = 0; l < net.layers.size(); ++l, std::swap(in, out)) {
    if (l + 1 == net.layers.size()) {
      convolve<false>(grid, net.layers[l], net.biases[l].data(), in, out);
      continue;
    }
    convolve<true>(grid, net.layers[l], net.biases[l].data(), in, out);
    grid.border(out, net.layers[l].outputs);
  }
  untile(net, grid, in, said.data());
  net.finer(turn.data(), 9, turns.data());
  const float tight = 1.0f / (net.limit * net.limit);
  for (int i = 0; i < all; i += kWide) {
    const int count = std::min(kWide, all - i);
    const float *y = said.data() + i, *axes = turns.data() + i;
    const V3<float> a = {load(y), load(y + all), load(y + 2 * all)};
    const F size = net.spacing * rsqrt(1.0f + tight * dot(a, a));
    for (int k = 0; k < 3; ++k, axes += all) {
      const V3<float> axis = {load(axes), load(axes + 3 * all), load(axes + 6 * all)};
      float* to = fine + k * all + i;
      store_few(to, load_few(to, count) + size * dot(axis, a), count);
    }
  }
}

constexpr DetailLanes instance = {add};

}  // namespace
}  // namespace LANES

DEFINE_LANES(DetailLanes, instance)

}  // namespace minicloth
