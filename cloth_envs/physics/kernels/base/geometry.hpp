// The grid as flat, padded arrays: what every kernel indexes.
#pragma once
#include <cstddef>
#include <new>
#include <vector>

namespace minicloth {

// A vertex (r, c) is element origin + r * stride + c. Two ghost rows lie above and below and at least
// two ghost columns between rows, so that a neighbour up to distance two is a constant offset. Edges that do not exist
// have weight 0, which makes masks unnecessary.
constexpr int kGhost = 2;
constexpr int kBlock = 16;  // loops run over whole blocks, the tail lies in ghosts

// Up to whole blocks, which are whole vectors of every instruction set.
constexpr int padded(int n) { return (n + kBlock - 1) / kBlock * kBlock; }

// Starts on a cache line, so that vectors at multiples of kBlock lie in one line each.
template <class T>
struct CacheLines {
  using value_type = T;
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64))); }
  void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(64)); }
  bool operator==(const CacheLines&) const { return true; }
  bool operator!=(const CacheLines&) const { return false; }
};
template <class T>
using Plane = std::vector<T, CacheLines<T>>;

template <class T>
struct Geometry {
  int rows, cols, stride, origin, begin, end;  // begin lies on a multiple of kBlock, for aligned loads
  std::size_t size;
  bool periodic;
  T row_length, col_length, diagonal;
  // Spring weights; times stretch (along, down) or shear (right, left) they are stiffnesses [N/m].
  Plane<T> along, down, right, left;
  // Bending as linear edges over distance one (near) and two (far); times bend_stiffness, [N/m].
  Plane<T> along_near, down_near, along_far, down_far;
  // The twist of bending, one mixed difference a cell, as linear edges: these times the springs' weights and times
  // bend_stiffness, [1/m^2]; |x00 - x01 - x10 + x11|^2 is the sum over the sides less that over the diagonals.
  T twist_along, twist_down, twist_diagonal;
  Plane<T> inverse_area;  // 1/m^2, 0 in ghosts
  Plane<T> cell;          // 1 where a cell's upper left corner is, else 0

  Geometry(int rows, int cols, double row_length, double col_length, bool periodic);
  int vertices() const { return rows * cols; }
  int at(int r, int c) const { return origin + r * stride + c; }
  int at(int vertex) const { return at(vertex / cols, vertex % cols); }
  // A field (3, rows, cols) to three planes and back.
  void pad(const T* field, T* const (&planes)[3]) const;
  void unpad(T* const (&planes)[3], T* field) const;
  // Gives the ghost columns of a tube what the columns hold that they stand for; nothing if it is open.
  void wrap(T* const (&planes)[3]) const;
};

template <class T>
struct Planes {  // positions and velocities
  T *x[3], *v[3];
};

}  // namespace minicloth
