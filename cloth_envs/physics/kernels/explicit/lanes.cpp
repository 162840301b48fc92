// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>

#include "core.hpp"
#include "slow.hpp"
#include "step.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
const ExplicitLanes<T> instance = {
    kLanes<T>,
    {{step<T, false, Part::kFree>, step<T, false, Part::kBodies>, step<T, false, Part::kLast>},
     {step<T, true, Part::kFree>, step<T, true, Part::kBodies>, step<T, true, Part::kLast>}},
    {{slow<T, false, kStill>, slow<T, false, kPressure>, slow<T, false, kMoving>},
     {slow<T, true, kStill>, slow<T, true, kPressure>, slow<T, true, kMoving>}},
};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ExplicitLanes<float>, instance<float>)
DEFINE_LANES(ExplicitLanes<double>, instance<double>)

}  // namespace minicloth
