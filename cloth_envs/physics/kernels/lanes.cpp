// Compiled with -ffast-math and once per instruction set (LANES names the namespace).
#include "lanes.hpp"

#include <cmath>

namespace minicloth {
namespace LANES {
namespace {

template <class T>
constexpr T tiny = T(1e-20);  // keeps ghosts, which all lie at the origin, finite

// Forces are gathered per vertex: an edge is evaluated from both ends by the same operations, so the
// two forces are equal and opposite to the last bit, and no array is written twice.
template <class T, bool kDamping, bool kBending, bool kAir>
void step(const Geometry<T>& g, const StepTerms<T>& p, const Planes<T>& in, const Planes<T>& out,
          const Triangles<T>* air) {
  const T *__restrict x = in.x, *__restrict y = in.y, *__restrict z = in.z;
  const T *__restrict vx = in.vx, *__restrict vy = in.vy, *__restrict vz = in.vz;
  T *__restrict ox = out.x, *__restrict oy = out.y, *__restrict oz = out.z;
  T *__restrict ovx = out.vx, *__restrict ovy = out.vy, *__restrict ovz = out.vz;
  const T *along = g.along.data(), *down = g.down.data(), *right = g.right.data(), *left = g.left.data();
  const T *along_near = g.along_near.data(), *down_near = g.down_near.data();
  const T *along_far = g.along_far.data(), *down_far = g.down_far.data(), *inverse_area = g.inverse_area.data();
  const int s = g.stride;
  const T stretch = p.stretch, shear = p.shear, bend = p.bend, damping = p.damping;
  const T col_length = g.col_length, row_length = g.row_length, diagonal = g.diagonal;

#pragma GCC ivdep
  for (int i = g.begin; i < g.end; ++i) {
    const T px = x[i], py = y[i], pz = z[i], qx = vx[i], qy = vy[i], qz = vz[i];
    T fx = 0, fy = 0, fz = 0;
    // f = k (1 - L/|d|) d + c (d.w)/|d|^2 d, with c = damping * k.
    const auto edge = [&](int j, T k, T length, T linear) __attribute__((always_inline)) {
      const T dx = x[j] - px, dy = y[j] - py, dz = z[j] - pz;
      const T inverse = 1 / std::sqrt(dx * dx + (dy * dy + (dz * dz + tiny<T>)));
      T pull = 1 - length * inverse;
      if constexpr (kDamping) {
        const T rate = dx * (vx[j] - qx) + (dy * (vy[j] - qy) + dz * (vz[j] - qz));
        pull += damping * rate * (inverse * inverse);
      }
      const T scale = k * pull + linear;
      fx += scale * dx, fy += scale * dy, fz += scale * dz;
    };
    const auto far = [&](int j, T k) __attribute__((always_inline)) { fx += k * (x[j] - px), fy += k * (y[j] - py), fz += k * (z[j] - pz); };
    const T none = 0;
    edge(i + 1, stretch * along[i], col_length, kBending ? bend * along_near[i] : none);
    edge(i - 1, stretch * along[i - 1], col_length, kBending ? bend * along_near[i - 1] : none);
    edge(i + s, stretch * down[i], row_length, kBending ? bend * down_near[i] : none);
    edge(i - s, stretch * down[i - s], row_length, kBending ? bend * down_near[i - s] : none);
    edge(i + s + 1, shear * right[i], diagonal, none);
    edge(i - s - 1, shear * right[i - s - 1], diagonal, none);
    edge(i + s - 1, shear * left[i], diagonal, none);
    edge(i - s + 1, shear * left[i - s + 1], diagonal, none);
    if constexpr (kBending) {
      far(i + 2, bend * along_far[i]);
      far(i - 2, bend * along_far[i - 2]);
      far(i + 2 * s, bend * down_far[i]);
      far(i - 2 * s, bend * down_far[i - 2 * s]);
    }
    if constexpr (kAir) {
      const auto share = [&](int k) __attribute__((always_inline)) {
        return air->lower[k][i] + air->upper[k][i] + air->lower[k][i - s - 1] + air->upper[k][i - s - 1] +
               air->lower[k][i - s] + air->upper[k][i - 1];
      };
      fx += share(0), fy += share(1), fz += share(2);
    }
    const T kick = p.accelerate * inverse_area[i];
    const T ux = p.decay * qx + kick * fx, uy = p.decay * qy + kick * fy;
    const T uz = p.decay * qz + kick * fz - p.gravity_kick;
    ovx[i] = ux, ovy[i] = uy, ovz[i] = uz;
    ox[i] = px + p.dt * ux, oy[i] = py + p.dt * uy, oz[i] = pz + p.dt * uz;
  }
}

// Wind (Wejchert & Haumann 1991) and pressure on the two triangles of each cell.
template <class T, bool kWind>
void air(const Geometry<T>& g, const AirTerms<T>& p, const Planes<T>& in, const Triangles<T>& out) {
  const T *__restrict x = in.x, *__restrict y = in.y, *__restrict z = in.z;
  const T *__restrict vx = in.vx, *__restrict vy = in.vy, *__restrict vz = in.vz;
  const T* __restrict cell = g.cell.data();
  const int s = g.stride;
  // A triangle's normal is half the cross product n of its sides; each vertex takes a third.
  const auto triangle = [&](int i, int j, int k, T *__restrict fx, T *__restrict fy, T *__restrict fz) __attribute__((always_inline)) {
    const T ax = x[j] - x[i], ay = y[j] - y[i], az = z[j] - z[i];
    const T bx = x[k] - x[i], by = y[k] - y[i], bz = z[k] - z[i];
    const T nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    T along = p.pressure / 2, tx = 0, ty = 0, tz = 0;
    if constexpr (kWind) {
      const T ux = (vx[i] + vx[j] + vx[k]) / 3 - p.wind[0];
      const T uy = (vy[i] + vy[j] + vy[k]) / 3 - p.wind[1];
      const T uz = (vz[i] + vz[j] + vz[k]) / 3 - p.wind[2];
      const T square = nx * nx + ny * ny + nz * nz + T(1e-30);
      const T inverse = 1 / std::sqrt(square);
      const T through = (nx * ux + ny * uy + nz * uz) * inverse;  // normal speed
      const T turn = through * inverse;
      tx = ux - turn * nx, ty = uy - turn * ny, tz = uz - turn * nz;
      const T slide = p.tangential * square * inverse * std::sqrt(tx * tx + ty * ty + tz * tz);
      tx *= slide, ty *= slide, tz *= slide;
      along -= p.normal * std::abs(through) * through;
    }
    const T share = cell[i] / 3;
    fx[i] = share * (along * nx - tx), fy[i] = share * (along * ny - ty), fz[i] = share * (along * nz - tz);
  };
#pragma GCC ivdep
  for (int i = g.begin; i < g.end; ++i) triangle(i, i + s, i + s + 1, out.lower[0], out.lower[1], out.lower[2]);
#pragma GCC ivdep
  for (int i = g.begin; i < g.end; ++i) {
    // Vertices i, i + s + 1, i + 1; written at the cell's upper left corner i.
    triangle(i, i + s + 1, i + 1, out.upper[0], out.upper[1], out.upper[2]);
  }
}

template <class T>
struct Vec {
  T x, y, z;
};

// The point of a body's axis nearest to q, and how far along the axis it lies.
template <class T>
inline Vec<T> nearest(const T (&ends)[2][3], T length2, Vec<T> q) {
  const T ax = ends[1][0] - ends[0][0], ay = ends[1][1] - ends[0][1], az = ends[1][2] - ends[0][2];
  T t = ((q.x - ends[0][0]) * ax + (q.y - ends[0][1]) * ay + (q.z - ends[0][2]) * az) / length2;
  t = t < 0 ? T(0) : (t > 1 ? T(1) : t);
  return {ends[0][0] + t * ax, ends[0][1] + t * ay, ends[0][2] + t * az};
}

// Swept contact with Coulomb friction. In the body's frame a vertex goes from p0 to p1; where it would
// enter, the tangent plane at the entry point holds it, at the speed of the body. Friction takes up to
// mu times the normal change of velocity from the sliding speed.
template <class T>
void contact(const Geometry<T>& g, const BodyStep<T>& b, const Planes<T>& in, const Planes<T>& out) {
  const T *__restrict x = in.x, *__restrict y = in.y, *__restrict z = in.z;
  T *__restrict ox = out.x, *__restrict oy = out.y, *__restrict oz = out.z;
  T *__restrict vx = out.vx, *__restrict vy = out.vy, *__restrict vz = out.vz;
  const T radius = b.radius, radius2 = radius * radius, rate = 1 / b.dt;
  T length2 = tiny<T>;
  for (int k = 0; k < 3; ++k) length2 += (b.before[1][k] - b.before[0][k]) * (b.before[1][k] - b.before[0][k]);
  const bool plane = b.plane;
  const T flat[3] = {b.after[1][0], b.after[1][1], b.after[1][2]};

  for (int r = 0; r < g.rows; ++r) {
    const int first = g.at(r, 0), last = first + g.cols;
    // Could anything in this row touch? Compare the nearest distance with the longest way gone.
    T reach = T(1e30);
    for (int i = first; i < last; ++i) {
      T gap;
      if (plane) {
        gap = (ox[i] - b.after[0][0]) * flat[0] + (oy[i] - b.after[0][1]) * flat[1] +
              (oz[i] - b.after[0][2]) * flat[2] - radius;
      } else {
        const Vec<T> c0 = nearest(b.before, length2, Vec<T>{x[i], y[i], z[i]});
        const Vec<T> c1 = nearest(b.after, length2, Vec<T>{ox[i], oy[i], oz[i]});
        const T ax = x[i] - c0.x, ay = y[i] - c0.y, az = z[i] - c0.z;
        const T px = ox[i] - c1.x, py = oy[i] - c1.y, pz = oz[i] - c1.z;
        const T way = (px - ax) * (px - ax) + (py - ay) * (py - ay) + (pz - az) * (pz - az);
        gap = std::sqrt(px * px + py * py + pz * pz) - std::sqrt(way) - radius;
      }
      reach = gap < reach ? gap : reach;
    }
    if (reach > 0) continue;

#pragma GCC ivdep
    for (int i = first; i < last; ++i) {
      T nx, ny, nz, gap, bx, by, bz;
      bool touching;
      if (plane) {
        nx = flat[0], ny = flat[1], nz = flat[2];
        gap = (ox[i] - b.after[0][0]) * nx + (oy[i] - b.after[0][1]) * ny + (oz[i] - b.after[0][2]) * nz - radius;
        bx = (b.after[0][0] - b.before[0][0]) * rate, by = (b.after[0][1] - b.before[0][1]) * rate;
        bz = (b.after[0][2] - b.before[0][2]) * rate;
        touching = gap < 0;
      } else {
        const Vec<T> c0 = nearest(b.before, length2, Vec<T>{x[i], y[i], z[i]});
        const Vec<T> c1 = nearest(b.after, length2, Vec<T>{ox[i], oy[i], oz[i]});
        const T ax = x[i] - c0.x, ay = y[i] - c0.y, az = z[i] - c0.z;
        const T px = ox[i] - c1.x, py = oy[i] - c1.y, pz = oz[i] - c1.z;
        const T dx = px - ax, dy = py - ay, dz = pz - az;
        const T start2 = ax * ax + ay * ay + az * az, outside = start2 - radius2;
        const T along = ax * dx + ay * dy + az * dz;
        const T disc = along * along - (dx * dx + dy * dy + dz * dz) * outside;
        const T root = std::sqrt(disc > 0 ? disc : T(0));
        const T time = outside / (root - along + tiny<T>);
        const bool inside = outside < 0;
        const bool enters = along < 0 && disc > 0 && time <= 1;
        const T way = !inside && enters ? time : T(0);
        const T scale = inside ? 1 / std::sqrt(start2 + tiny<T>) : 1 / radius;
        nx = (ax + way * dx) * scale, ny = (ay + way * dy) * scale, nz = (az + way * dz) * scale;
        gap = nx * px + ny * py + nz * pz - radius;
        bx = (c1.x - c0.x) * rate, by = (c1.y - c0.y) * rate, bz = (c1.z - c0.z) * rate;
        touching = (inside || enters) && gap < 0;
      }
      const T ux = vx[i] - bx, uy = vy[i] - by, uz = vz[i] - bz;
      const T un = ux * nx + uy * ny + uz * nz;
      const T stop = touching && un < 0 ? -un : T(0);  // normal change of velocity
      const T tx = ux - un * nx, ty = uy - un * ny, tz = uz - un * nz;
      const T sliding = std::sqrt(tx * tx + ty * ty + tz * tz + tiny<T>);
      const T held = b.friction * stop / sliding;
      const T hold = held < 1 ? held : T(1);
      const T push = touching ? -gap : T(0);
      vx[i] += stop * nx - hold * tx, vy[i] += stop * ny - hold * ty, vz[i] += stop * nz - hold * tz;
      ox[i] += push * nx - b.dt * hold * tx, oy[i] += push * ny - b.dt * hold * ty;
      oz[i] += push * nz - b.dt * hold * tz;
    }
  }
}

template <class T>
const Lanes<T> table = {
    {{{step<T, false, false, false>, step<T, false, false, true>},
      {step<T, false, true, false>, step<T, false, true, true>}},
     {{step<T, true, false, false>, step<T, true, false, true>},
      {step<T, true, true, false>, step<T, true, true, true>}}},
    {air<T, false>, air<T, true>},
    contact<T>,
};

}  // namespace

const Lanes<float>& lanes(float) { return table<float>; }
const Lanes<double>& lanes(double) { return table<double>; }

}  // namespace LANES
}  // namespace minicloth
