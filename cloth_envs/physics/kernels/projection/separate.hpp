// Draws folds of an upscaled cloth out of each other.
#pragma once
#include <functional>
#include <vector>

#include "../sheet/sheet.hpp"

namespace minicloth {

// Vertices that stay where they are, and what puts them there in other cloths of the sheet (3, rows, cols), those
// around with them and all outside bodies.
struct Held {
  const std::vector<int>& vertices;
  std::function<void(float*)> put;
};

// The facets of a coarse cloth, its triangles between straight edges, do not cross where contact kept the coarse cloth
// out of itself. A fine one of the same sheet, curved and wrinkled, may. Its vertices at triangles that cross are drawn
// half-way to their places in the facets, those around them less, again and again until none cross (bisection). Where
// facets with a common vertex cross, which contact does not see and smaller ones on them do, vertices are drawn between
// those around them. What still crosses, as where the coarse cloth does, is put into the facets if fewer pairs cross
// there: as many at most as in a cloth that is all facets.
// Positions x (3, rows, cols) of the sheet, in place; coarse (3, h, w). `again`: after the same cloth, of which some
// vertices moved. Whether vertices were moved.
bool separate(const Sheet& sheet, const Held& held, const float* coarse, int h, int w, float* x, bool again);

}  // namespace minicloth
