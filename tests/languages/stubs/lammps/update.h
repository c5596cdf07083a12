#pragma once
namespace LAMMPS_NS {
class Update {
public:
    double dt = 0;
};
}  // namespace LAMMPS_NS
