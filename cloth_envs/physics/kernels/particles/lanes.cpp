// Compiled once per instruction set; LANES names the namespace.
#include <cmath>

#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Adds F = alpha d + beta n + gamma (w . n) n, n = d / sqrt(|d|^2 + eps), to particles first .. last - 1 of a row;
// d and w are the neighbour's position and velocity less the particle's own.
template <class T>
void add_link(const Link<T>& link, T eps, int first, int last, int to, int plane, const T* x, const T* v,
              T* __restrict__ f) {
  const T *x1 = x + plane, *x2 = x1 + plane, *v1 = v + plane, *v2 = v1 + plane;
  T* __restrict__ f1 = f + plane, * __restrict__ f2 = f1 + plane;
  const T alpha = link.alpha, beta = link.beta, gamma = link.gamma;
  for (int i = first; i < last; ++i) {
    const T d0 = x[i + to] - x[i], d1 = x1[i + to] - x1[i], d2 = x2[i + to] - x2[i];
    const T w0 = v[i + to] - v[i], w1 = v1[i + to] - v1[i], w2 = v2[i + to] - v2[i];
    const T inverse = T(1) / std::sqrt(d0 * d0 + d1 * d1 + d2 * d2 + eps);
    const T scale = alpha + inverse * (beta + gamma * inverse * (d0 * w0 + d1 * w1 + d2 * w2));
    f[i] += scale * d0, f1[i] += scale * d1, f2[i] += scale * d2;
  }
}

// Pressure (eq. 3): p times the sum of r_a x r_b over the four pairs of nearest neighbours, counter-clockwise seen
// from the side it pushes to. The sum is (right - left) x (up - down); where a neighbour is missing, so is what it
// would have added, as if it lay on the particle.
template <class T>
void add_pressure(T p, int first, int last, int left, int right, int up, int down, int plane, const T* x,
                  T* __restrict__ f) {
  const T *x1 = x + plane, *x2 = x1 + plane;
  T* __restrict__ f1 = f + plane, * __restrict__ f2 = f1 + plane;
  for (int i = first; i < last; ++i) {
    const T a0 = x[i + right] - x[i + left], a1 = x1[i + right] - x1[i + left], a2 = x2[i + right] - x2[i + left];
    const T b0 = x[i + up] - x[i + down], b1 = x1[i + up] - x1[i + down], b2 = x2[i + up] - x2[i + down];
    f[i] += p * (a1 * b2 - a2 * b1), f1[i] += p * (a2 * b0 - a0 * b2), f2[i] += p * (a0 * b1 - a1 * b0);
  }
}

template <class T>
void velocities(const NetStep<T>& s, const T* x, const T* v, T* __restrict__ out) {
  const int cols = s.cols, plane = s.rows * cols;
  for (int r = 0; r < s.rows; ++r) {
    const int row = r * cols;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < cols; ++c) out[k * plane + row + c] = s.bias[k];
    for (int n = 0; n < s.count; ++n) {
      const Link<T>& link = s.links[n];
      if (r + link.down < 0 || r + link.down >= s.rows) continue;
      const int first = link.right < 0 ? -link.right : 0, last = link.right > 0 ? cols - link.right : cols;
      add_link(link, s.eps, first, last, link.down * cols + link.right, plane, x + row, v + row, out + row);
    }
    if (s.pressure != 0) {
      const int up = r > 0 ? -cols : 0, down = r + 1 < s.rows ? cols : 0, last = cols - 1;
      add_pressure(s.pressure, 0, 1, 0, 1, up, down, plane, x + row, out + row);
      add_pressure(s.pressure, 1, last, -1, 1, up, down, plane, x + row, out + row);
      add_pressure(s.pressure, last, cols, -1, 0, up, down, plane, x + row, out + row);
    }
    for (int k = 0; k < 3; ++k)
      for (int i = k * plane + row; i < k * plane + row + cols; ++i) out[i] = (v[i] + s.kick * out[i]) * s.decay;
  }
}

template <class T>
void ball(const NetBall<T>& b, int n, const T* x, T* __restrict__ v) {
  const T *x1 = x + n, *x2 = x1 + n, square = b.radius * b.radius;
  T* __restrict__ v1 = v + n, * __restrict__ v2 = v1 + n;
  for (int i = 0; i < n; ++i) {
    const T d0 = x[i] - b.centre[0], d1 = x1[i] - b.centre[1], d2 = x2[i] - b.centre[2];
    const T u0 = v[i] - b.velocity[0], u1 = v1[i] - b.velocity[1], u2 = v2[i] - b.velocity[2];
    const T away = d0 * d0 + d1 * d1 + d2 * d2, along = d0 * u0 + d1 * u1 + d2 * u2;
    const bool inside = away < square && away > 0;
    const T inwards = inside && along < 0 ? along / away : T(0), keep = inside ? b.keep : T(1);
    const T n0 = b.velocity[0] + keep * (u0 - inwards * d0), n1 = b.velocity[1] + keep * (u1 - inwards * d1),
            n2 = b.velocity[2] + keep * (u2 - inwards * d2);
    v[i] = inside ? n0 : v[i], v1[i] = inside ? n1 : v1[i], v2[i] = inside ? n2 : v2[i];
  }
}

template <class T>
void positions(int numbers, T dt, const T* x, const T* v, T* __restrict__ out) {
  for (int i = 0; i < numbers; ++i) out[i] = x[i] + dt * v[i];
}

template <class T>
const NetLanes<T> table = {velocities<T>, ball<T>, positions<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(NetLanes<float>, table<float>)
DEFINE_LANES(NetLanes<double>, table<double>)

}  // namespace minicloth
