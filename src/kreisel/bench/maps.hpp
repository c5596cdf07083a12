// The five maps for n = 3, written by hand with axial vectors: X = hat(u), hat(u) v = u x v, x ^ y = hat(y x x).
// The paper's formulas as they stand.
// States and parameters come at run time, in the rows of kreisel's kernels: (M_01, M_02, M_12) = (-w3, w2, -w1).
// Real is double, or a vector of doubles, one for each of LANES trajectories.

struct Vec {
    Real x, y, z;
};

static inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Vec operator-(Vec a) { return {-a.x, -a.y, -a.z}; }
static inline Vec operator*(Real s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
#ifdef LANES
static inline Vec operator*(double s, Vec a) { return (s + Real{}) * a; }
#endif
static inline Vec operator*(Vec a, Vec b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
static inline Real dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline Vec cross(Vec a, Vec b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline Vec vector_at(const Real *z) { return {z[0], z[1], z[2]}; }
static inline Vec axial_at(const Real *z) { return {-z[2], z[1], -z[0]}; }
static inline void put_vector(Real *z, Vec v) { z[0] = v.x, z[1] = v.y, z[2] = v.z; }
static inline void put_axial(Real *z, Vec w) { z[0] = -w.z, z[1] = w.y, z[2] = -w.x; }

// c + a x b, summed from c on
static inline Vec add_cross(Vec c, Vec a, Vec b) {
    return {(c.x + a.y * b.z) - a.z * b.y, (c.y + a.z * b.x) - a.x * b.z, (c.z + a.x * b.y) - a.y * b.x};
}

// cay(hat(u)) and (I - hat(u))^-1
struct Cayley {
    Vec u;
    Real scale;
    explicit Cayley(Vec u) : u(u), scale(1 / (1 + dot(u, u))) {}
    Vec resolvent(Vec v) const { return scale * (add_cross(v, u, v) + dot(u, v) * u); }
    Vec act(Vec v) const {
        Vec twice = 2.0 * u, w = cross(twice, v), y = scale * add_cross(w, u, w); // u.w = 0
        return v + y;
    }
};

struct LagrangeTop { // c = p, alpha, eps
    Vec m, a, p;
    Real eps;
    LagrangeTop(const Real *z, const Real *c) : m(axial_at(z)), a(vector_at(z + 3)), p(vector_at(c)), eps(c[4]) {}
    void step() {
        m = m - eps * cross(a, p);
        a = Cayley(eps / 2 * m).act(a);
    }
    void store(Real *z) const { put_axial(z, m), put_vector(z + 3, a); }
};

struct LagrangeTopMoving { // c = A, alpha, eps
    Vec M, P, A;
    Real alpha, eps;
    LagrangeTopMoving(const Real *z, const Real *c)
        : M(axial_at(z)), P(vector_at(z + 3)), A(vector_at(c)), alpha(c[3]), eps(c[4]) {}
    void step() {
        Vec u = eps / 2 * M;
        Vec y = Cayley(u).resolvent(A);
        Cayley back(-((1 / alpha) * u + (1 - alpha) / alpha / dot(A, y) * cross(y, A))); // W = cay(X)
        P = back.act(P);
        M = back.act(M) + eps * cross(P, A);
    }
    void store(Real *z) const { put_axial(z, M), put_vector(z + 3, P); }
};

struct SymmetricTop { // c = A, eps
    Vec M, P, A;
    Real eps;
    SymmetricTop(const Real *z, const Real *c) : M(axial_at(z)), P(vector_at(z + 3)), A(vector_at(c)), eps(c[3]) {}
    void step() {
        M = M + eps * cross(P, A);
        P = Cayley(-eps / 2 * M).act(P);
    }
    void store(Real *z) const { put_axial(z, M), put_vector(z + 3, P); }
};

struct Clebsch { // c = b, eps
    Vec M, P, b;
    Real eps;
    Clebsch(const Real *z, const Real *c) : M(axial_at(z)), P(vector_at(z + 3)), b(vector_at(c)), eps(c[3]) {}
    void step() {
        Vec BP = b * P;
        M = M + eps / (1 + eps * eps / 4 * dot(P, BP)) * cross(BP, P);
        P = Cayley(-eps / 2 * M).act(P);
    }
    void store(Real *z) const { put_axial(z, M), put_vector(z + 3, P); }
};

// cay(x ^ y) in the plane of x and y
struct Neumann { // c = b, eps
    Vec x, q, b;
    Real eps;
    Neumann(const Real *z, const Real *c) : x(vector_at(z)), q(vector_at(z + 3)), b(vector_at(c)), eps(c[3]) {}
    void step() {
        Vec Bx = b * x;
        q = q + eps / (1 + eps * eps / 4 * dot(x, Bx)) * Bx;
        q = q - dot(x, q) / dot(x, x) * x;
        Cayley circle(-eps / 2.0 * cross(q, x));
        x = circle.act(x), q = circle.act(q);
    }
    void store(Real *z) const { put_vector(z, x), put_vector(z + 3, q); }
};
