// What the threads of a block share while they step a cloth.
#pragma once
#include "../sheet/contact.hpp"
#include "terms.hpp"

namespace minicloth {
namespace LANES {
namespace {

struct alignas(8) Pair {
  float a, b;  // positions, and those `damping` times the velocity later; or other two fields
};
struct Point {
  V3<float> a, b;
};

// What a cell's four corners feel alike, `to` less `over` times their velocities [N].
struct alignas(16) Cell {
  V3<float> to;
  float over;
};

// A handle's path, from p0 + rest at v0 [per frame], its springs, and how far from p0 it should be at the end of the
// step: what soft ones lack to their paths would drown in the rounding of places.
struct Held {
  float p0[3], v0[3], c2[3], c3[3];
  float rate[3], share[3];  // 1/s^2, 0 of a firm one; of the way to its path what a soft one goes in a step
  V3<float> rest, ahead, speed;
  int firm;
};

struct Driven {
  Cubic path[6];
  BodyLanes<float, 1> step;
  Moving<float> moving;
};

struct Kick {
  float accelerate, decay, fall;  // force/area -> dv, factor, dv of gravity
};

// What the air and a pressure are in a frame, as AirTerms of air.hpp.
struct Weather {
  float normal, lift, tangential, pressure;
  V3<float> wind;  // four times it
};

enum Slot { kShear, kApart, kBad, kStrain, kSpeed, kSlots };

struct Shared {
  Cell* cells;  // of every vertex, whose upper left corner it is; none without air and pressure
  Driven* driven;
  Pair* field;  // (3, H W)
  float* slow;  // (3, H W), forces that are held [N]; each is one thread's own
  Held* held;
  int* slots;   // Slot
  float* sums;  // one a warp
  Kick* kicks;  // half a one, a whole one
  CardCloth* cloth;
  Weather* weather;
  unsigned char* handle_of;  // (H W), of one byte where that is enough
  static constexpr int kMostSlots = 8, kSums = 32;

  static std::size_t cells_of(const CardSheet& s) { return s.air || s.pressure ? std::size_t(s.rows) * s.cols : 0; }
  static std::size_t slow_of(const CardSheet& s) { return s.spare ? 0 : 3 * std::size_t(s.rows) * s.cols; }
  static std::size_t field_of(const CardSheet& s) { return 3 * std::size_t(s.rows) * s.cols; }
  // `spare` is where the cloth's positions at the frame's end will be.
  Shared(const CardSheet& s, unsigned char* memory, float* spare)
      : cells(reinterpret_cast<Cell*>(memory)),
        driven(reinterpret_cast<Driven*>(cells + cells_of(s))),
        field(reinterpret_cast<Pair*>(driven + s.bodies)),
        slow(s.spare ? spare : reinterpret_cast<float*>(field + field_of(s))),
        held(reinterpret_cast<Held*>(reinterpret_cast<float*>(field + field_of(s)) + slow_of(s))),
        slots(reinterpret_cast<int*>(held + s.handles)),
        sums(reinterpret_cast<float*>(slots + kMostSlots)),
        kicks(reinterpret_cast<Kick*>(sums + kSums)),
        cloth(reinterpret_cast<CardCloth*>(kicks + 2)),
        weather(reinterpret_cast<Weather*>(cloth + 1)),
        handle_of(reinterpret_cast<unsigned char*>(weather + 1)) {}
  static std::size_t bytes(const CardSheet& s) {
    return cells_of(s) * sizeof(Cell) + s.bodies * sizeof(Driven) + field_of(s) * sizeof(Pair) +
           slow_of(s) * sizeof(float) + s.handles * sizeof(Held) + kMostSlots * sizeof(int) + kSums * sizeof(float) +
           2 * sizeof(Kick) + sizeof(CardCloth) + sizeof(Weather) +
           std::size_t(s.rows) * s.cols *
               (s.handles > 256 ? 2
                : s.handles > 0 ? 1
                                : 0);
  }

  Held& handle(const CardSheet& s, int vertex) const {
    return held[s.handles > 256 ? 256 * handle_of[2 * vertex] + handle_of[2 * vertex + 1] : handle_of[vertex]];
  }
  void put_handle(const CardSheet& s, int vertex, int number) const {
    if (s.handles > 256)
      handle_of[2 * vertex] = (unsigned char)(number / 256), handle_of[2 * vertex + 1] = (unsigned char)(number % 256);
    else
      handle_of[vertex] = (unsigned char)(number);
  }
  V3<float> force(const CardSheet& s, int vertex) const {
    const int n = s.rows * s.cols;
    return {slow[vertex], slow[n + vertex], slow[2 * n + vertex]};
  }
  void put_force(const CardSheet& s, int vertex, const V3<float>& f) const {
    const int n = s.rows * s.cols;
    slow[vertex] = f.x, slow[n + vertex] = f.y, slow[2 * n + vertex] = f.z;
  }
  Point at(const CardSheet& s, int vertex) const {
    const int n = s.rows * s.cols;
    const Pair x = field[vertex], y = field[n + vertex], z = field[2 * n + vertex];
    return {{x.a, y.a, z.a}, {x.b, y.b, z.b}};
  }
  void put(const CardSheet& s, int vertex, const V3<float>& a, const V3<float>& b) const {
    const int n = s.rows * s.cols;
    field[vertex] = {a.x, b.x}, field[n + vertex] = {a.y, b.y}, field[2 * n + vertex] = {a.z, b.z};
  }
};

}  // namespace
}  // namespace LANES
}  // namespace minicloth
