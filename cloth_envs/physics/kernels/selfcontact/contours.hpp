// Where a cloth crosses itself: edges through triangles, joined to contours, and which way leads out.
#pragma once
#include <array>
#include <vector>

#include "../base/vec.hpp"
#include "near.hpp"

namespace minicloth {

// An edge through a triangle: the edge's ends and the triangle's corners, all vertices.
struct Hit {
  std::array<int, 5> at;
  int edge;           // 3 v, 3 v + 1, 3 v + 2: from vertex v to the right, down, along the diagonal
  int own, triangle;  // a triangle of the edge, and what it goes through: 2 i, 2 i + 1, the lower and upper of cell i
  int contour;
  int inside;        // which end has gone through and has to come back, 0 or 1; -1 where that is not known
  Vec<double> spot;  // m, where they cross
  Vec<double> way;   // along which the edge goes against the triangle to shorten the contour, 1 at most
};

// Finds them in cloths of one grid; cells are numbered as in Sweep.
class Contours {
 public:
  void shape(int rows, int cols, bool periodic);
  // Of positions in three planes and the pairs of cells that may cross each other.
  template <class T>
  const std::vector<Hit>& find(const T* x, std::size_t plane, const std::vector<MeetingCells>& cells);
  // How many pairs of triangles cross.
  int pairs() const { return pairs_; }
  // Whether triangles of cells beside these two cross each other, or both are in one part that is drawn back.
  bool near(int first, int second) const;
  // Vertices of hits and of the parts that they cut off.
  const std::vector<int>& tangled() const { return tangled_; }
  // Those beside a vertex along rows, columns and the diagonal, in opposite pairs; how many.
  int neighbours(int v, int (&to)[6]) const;

 private:
  struct Link {
    int hits[2];
    int other(int i) const { return hits[hits[0] == i]; }
  };
  bool exists(int cell) const { return triangles_[2 * cell][0] >= 0; }
  int right(int v) const { return (v + 1) % cols_ ? v + 1 : periodic_ ? v + 1 - cols_ : -1; }
  int left(int v) const { return v % cols_ ? v - 1 : periodic_ ? v - 1 + cols_ : -1; }
  const std::array<int, 3>& triangle(int i) const { return triangles_[i]; }
  void test(int a, int b);
  bool hit(int triangle, int other);
  void join();
  void ends();
  void shorten();
  int across(const Hit& hit) const;

  void regions();
  void sides(int first, int last);
  void flood(int seed, int limit);
  void close(int first, int last);
  void mark();

  int rows_ = 0, cols_ = 0, pairs_ = 0, stamp_ = 0;
  bool periodic_ = false;
  std::vector<std::array<int, 3>> triangles_;  // -1 of cells without any
  std::vector<Vec<double>> at_;
  std::vector<Hit> hits_;
  std::vector<Link> links_;
  std::vector<std::vector<int>> joined_;  // of hits: their links
  std::vector<int> stop_;  // of hits at the end of a contour: a vertex that both sheets have, -1 a border; else -2
  std::vector<int> group_, order_;
  std::vector<int> cut_, region_, size_, queue_;  // of edges; of vertices; of regions: vertices; to visit
  std::vector<int> pocket_, tangled_;             // of vertices: which contour cuts it off
  std::vector<int> first_, crossed_;              // cells that cell i crosses: crossed_[first_[i]] and on
  std::vector<std::array<int, 2>> cells_;         // pairs of cells that cross, both ways round
};

}  // namespace minicloth
