// Numbers of two doubles, 106 bits: T. J. Dekker, Numer. Math. 18 (1971) 224; sums and products without an error term
// are those of D. E. Knuth and of a fused multiply-add.  To be compiled without contraction.
#pragma once
#include <cmath>

struct dd {
    double h, l;
    dd(double h = 0, double l = 0) : h(h), l(l) {}
};
inline dd quick(double a, double b) { double s = a + b; return dd(s, b - (s - a)); }
inline dd sum(double a, double b) { double s = a + b, t = s - a; return dd(s, (a - (s - t)) + (b - t)); }
inline dd operator-(dd a) { return dd(-a.h, -a.l); }
inline dd operator+(dd a, dd b) {
    dd s = sum(a.h, b.h), t = sum(a.l, b.l);
    s = quick(s.h, s.l + t.h);
    return quick(s.h, s.l + t.l);
}
inline dd operator-(dd a, dd b) { return a + (-b); }
inline dd operator*(dd a, dd b) {
    double p = a.h * b.h;
    return quick(p, std::fma(a.h, b.h, -p) + (a.h * b.l + a.l * b.h));
}
inline dd operator/(dd a, dd b) {
    double q = a.h / b.h;
    dd r = a - b * dd(q);
    double u = r.h / b.h;
    r = r - b * dd(u);
    return quick(q, u) + dd(r.h / b.h);
}
inline dd sqrt(dd a) {
    if (a.h <= 0) return dd(0);
    double x = std::sqrt(a.h);
    dd r = a - dd(x) * dd(x);
    dd y = quick(x, r.h / (2 * x));
    return y + (a - y * y) / (dd(2) * y);
}
inline dd fma(dd a, dd b, dd c) { return a * b + c; }
inline dd sign(dd a) { return a.h < 0 ? -1.0 : 1.0; }
inline dd max(dd a, dd b) { return a.h > b.h || (a.h == b.h && a.l > b.l) ? a : b; }
