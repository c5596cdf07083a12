#pragma once
#include "atom.h"
namespace LAMMPS_NS {
class AtomVecEllipsoid : public AtomVec {
public:
    struct Bonus {
        double shape[3];
        double quat[4];
        int ilocal;
    };
    Bonus *bonus = nullptr;
};
}  // namespace LAMMPS_NS
