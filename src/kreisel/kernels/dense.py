"""Helpers of array code, for n beyond straight-line code; written into each kernel, Numba keeps them with it."""

HELPERS = """
@njit({options})
def add(x, y):
    return x + y


@njit({options})
def subtract(x, y):
    return x - y


@njit({options})
def multiply(x, y):
    return x * y


@njit({options})
def divide(x, y):
    return x / y


@njit({options})
def power(x, y):
    return x**y


@njit({options})
def root(x):
    return np.sqrt(x)


@njit({options})
def negative(x):
    return -x


@njit({options})
def number(flat, n):
    return flat[0]


@njit({options})
def vector(flat, n):
    return flat.copy()


@njit({options})
def matrix(flat, n):
    return flat.copy().reshape((n, n))


@njit({options})
def skew(flat, n):
    X, k = np.zeros((n, n)), 0
    for i in range(n):
        for j in range(i + 1, n):
            X[i, j], X[j, i] = flat[k], -flat[k]
            k += 1
    return X


@njit({options})
def mirror(X):
    # the entries i < j are the state; the others would drift away from their negatives
    n = X.shape[0]
    for i in range(n):
        X[i, i] = 0.0
        for j in range(i + 1, n):
            X[j, i] = -X[i, j]
    return X


@njit({options})
def symmetric(flat, n):
    X, k = np.empty((n, n)), 0
    for i in range(n):
        for j in range(i, n):
            X[i, j] = X[j, i] = flat[k]
            k += 1
    return X


@njit({options})
def eliminated(A, B):
    # A^-1 B without pivoting, as kreisel.algebra.solve has it
    n, k, A, X = A.shape[0], B.shape[1], A.copy(), B.copy()
    for p in range(n):
        scale = 1.0 / A[p, p]
        for i in range(p + 1, n):
            c = A[i, p] * scale
            for j in range(p + 1, n):
                A[i, j] -= c * A[p, j]
            for j in range(k):
                X[i, j] -= c * X[p, j]
    for p in range(n - 1, -1, -1):
        scale = 1.0 / A[p, p]
        for j in range(k):
            x = X[p, j]
            for i in range(p + 1, n):
                x -= A[p, i] * X[i, j]
            X[p, j] = x * scale
    return X


@njit({options})
def mirror_symmetric(X):
    n = X.shape[0]
    for i in range(n):
        for j in range(i + 1, n):
            X[j, i] = X[i, j]
    return X


@njit({options})
def store_symmetric(X, flat):
    k = 0
    for i in range(X.shape[0]):
        for j in range(i, X.shape[0]):
            flat[k] = X[i, j]
            k += 1


@njit({options})
def store(X, flat):
    flat[:] = X.reshape(X.size)


@njit({options})
def store_number(x, flat):
    flat[0] = x


@njit({options})
def store_skew(X, flat):
    k = 0
    for i in range(X.shape[0]):
        for j in range(i + 1, X.shape[0]):
            flat[k] = X[i, j]
            k += 1


"""
