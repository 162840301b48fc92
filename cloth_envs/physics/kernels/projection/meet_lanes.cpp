// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cstring>

#include "../selfcontact/planes.hpp"
#include "meet_pairs.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Where triangle i of a cell and triangle j of one that is `step` elements further have a vertex in common.
inline Mask<float> common(const Mask<float>& step, int stride, int i, int j) {
  const int a[3] = {0, stride + 1, i ? 1 : stride}, b[3] = {0, stride + 1, j ? 1 : stride};
  Mask<float> found = {};
  for (int k = 0; k < 9; ++k) found |= step == a[k / 3] - b[k % 3];
  return found;
}

// Which triangles of the pairs of cells have no vertex in common and are not on one side of each other's planes.
void triangles(Meeting& m) {
  const int count = int(m.pairs[0].size());
  for (auto& pairs : m.pairs) pairs.resize(count + n, count ? pairs[0] : 0);
  for (int first = 0; first < count; first += n) {
    V3<float> p[2][4];
    for (int half = 0; half < 2; ++half)
      for (int q = 0; q < 4; ++q) {
        const float* const x = m.x.data() + q % 2 + q / 2 * m.stride;
        const int* const cells = m.pairs[half].data() + first;
        p[half][q] = {gather<float>(x, cells), gather<float>(x + m.plane, cells),
                      gather<float>(x + 2 * m.plane, cells)};
      }
    const Sides<float> one = sides<float>(p[0], p[1]), other = sides<float>(p[1], p[0]);
    Mask<float> from, to;
    std::memcpy(&from, m.pairs[0].data() + first, sizeof from), std::memcpy(&to, m.pairs[1].data() + first, sizeof to);
    unsigned may[2][2], some = 0;
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        const Mask<float> apart = one.apart[i][j] | other.apart[j][i] | common(to - from, m.stride, i, j);
        some |= may[i][j] = bits<float>(~apart);
      }
    for (; some; some &= some - 1) {
      const int l = __builtin_ctz(some);
      if (first + l >= count) break;
      const auto bit = [&](int i, int j) { return (may[i][j] >> l & 1) << (2 * i + j); };
      m.cells.push_back({m.pairs[0][first + l], m.pairs[1][first + l], bit(0, 0) | bit(0, 1) | bit(1, 0) | bit(1, 1)});
    }
  }
}

void find(Meeting& m, const float* x, const float* mark, bool all) {
  take(m, x, mark, all);
  const auto fresh = [&](int r) { return m.fresh_rows[r / kSide]; };
  for (int r = 0; r < m.down; ++r)
    if (fresh(r)) cells_of(m, r);
  for (int r = 0; r < m.down; ++r)
    if (fresh(std::max(r - 1, 0)) | fresh(std::min(r + 1, m.down - 1))) evenness(m, r);
  boxes(m);
  std::fill(m.filled.begin(), m.filled.end(), 0);
  for (auto& pairs : m.pairs) pairs.clear();
  m.cells.clear();
  blocks(m);
  triangles(m);
}

constexpr MeetLanes instance = {find};

}  // namespace
}  // namespace LANES

DEFINE_LANES(MeetLanes, instance)

}  // namespace minicloth
