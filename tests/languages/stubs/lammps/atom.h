#pragma once
namespace LAMMPS_NS {
class AtomVec {
public:
    virtual ~AtomVec() = default;
};
class Atom {
public:
    int nlocal = 0;
    int *mask = nullptr, *ellipsoid = nullptr;
    double *rmass = nullptr;
    double **angmom = nullptr, **torque = nullptr;
    AtomVec *avec = nullptr;
};
}  // namespace LAMMPS_NS
