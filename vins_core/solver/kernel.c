/* The projections of a window in one pass: evaluate, weigh, add up what the inverse depths see.
 *
 * Compiled together with `evaluate` functions that are generated from the CasADi residuals (factors/c_source.py), and
 * called through ctypes (compiled_rows.py).  Each operation is rounded by itself and every sum runs in the order in
 * which NumpyRows (visual_rows.py) adds it up, so both give the same bits.
 */
#include <math.h>
#include <stdint.h>

enum { LANES = 64 }; /* projections evaluated together */
enum { POSE = 7, TANGENT = 6, MAX_DATA = 24, MAX_BLOCKS = 4 };
enum loss { NONE, CAUCHY, HUBER };

typedef void evaluate_fn(const double (*restrict x)[LANES], double (*restrict y)[LANES]);

/* Mirrored by compiled_rows.Arguments.  Matrices are row-major. */
struct arguments {
  /* the window's structure */
  int64_t n;               /* projections */
  int64_t width;           /* columns of W */
  int64_t loss;            /* enum loss */
  int64_t curved;          /* with the curvature of the loss */
  double scale;            /* of the loss */
  const int64_t *anchor;   /* (n,) row of poses */
  const int64_t *observer; /* (n,) row of poses */
  const int64_t *landmark; /* (n,) row of W */
  const int64_t *start;    /* (blocks, n) first column in W of each camera block, then of td */
  const int64_t *place;    /* (2, n) row of `packed` for both rows of a projection */
  const int64_t *row;      /* (n,) column of `residuals` */
  const double *data;      /* (n_data, n) */
  /* the states */
  const double *poses;      /* (frames, 7) */
  const double *extrinsics; /* (1 or 2, 7) of the cameras involved */
  const double *td_s;       /* (1,) */
  const double *inv_depths; /* (landmarks,) */
  /* the results */
  double *residuals; /* (2, n) unweighted */
  double *squared;   /* (n,) their squared norms */
  double *packed;    /* (2 n, camera columns + 1) J of the camera blocks and r, weighted */
  double *W;         /* (landmarks, width), zero on entry, as are */
  double *h;         /* (landmarks,) and */
  double *g_l;       /* (landmarks,) */
};

static inline double weight(enum loss loss, double scale, double s) {
  const double a2 = scale * scale;
  if (loss == CAUCHY) return 1.0 / sqrt(1.0 + s / a2);
  if (loss == HUBER) return sqrt(scale / sqrt(s < a2 ? a2 : s));
  return 1.0;
}

/* What `evaluate` reads, for the projections from `first` on; spare lanes repeat the last one. */
static inline void gather(const struct arguments *a, int64_t first, int lanes, int n_poses, int n_extrinsics,
                          int n_td, int n_data, double (*x)[LANES]) {
  const int held = POSE * n_poses, td = held + POSE * n_extrinsics, depth = td + n_td;
  for (int l = 0; l < LANES; l++) {
    const int64_t i = first + (l < lanes ? l : lanes - 1);
    for (int k = 0; n_poses && k < POSE; k++) {
      x[k][l] = a->poses[a->anchor[i] * POSE + k];
      x[POSE + k][l] = a->poses[a->observer[i] * POSE + k];
    }
    for (int k = 0; k < n_extrinsics * POSE; k++) x[held + k][l] = a->extrinsics[k];
    if (n_td) x[td][l] = a->td_s[0];
    x[depth][l] = a->inv_depths[a->landmark[i]];
    for (int k = 0; k < n_data; k++) x[depth + 1 + k][l] = a->data[k * a->n + i];
  }
}

/* The curvature of the loss along the residual, in units of its weight. */
static inline double curvature(enum loss loss, double scale, double s) {
  const double a2 = scale * scale, floor = 0.2; /* robust.MIN_CURVATURE */
  if (loss == CAUCHY) {
    const double u = s / a2, k = (1.0 - u) / (1.0 + u);
    return k < floor ? floor : k;
  }
  return loss == HUBER && s > a2 ? floor : 1.0;
}

/* Lets J see the curvature of the loss: see factors/robust.py. */
static inline void bend(const struct arguments *a, int columns, const double *s, const double (*r)[LANES],
                        double (*y)[LANES]) {
  double shrink[LANES], root[LANES];
  for (int l = 0; l < LANES; l++) {
    root[l] = sqrt(curvature(a->loss, a->scale, s[l]));
    shrink[l] = (1.0 - root[l]) / (s[l] < 1e-300 ? 1e-300 : s[l]);
  }
  for (int k = 0; k < columns - 1; k++)
    for (int l = 0; l < LANES; l++) {
      const double along = (y[2 * k][l] * r[0][l] + y[2 * k + 1][l] * r[1][l]) * shrink[l];
      y[2 * k][l] -= along * r[0][l];
      y[2 * k + 1][l] -= along * r[1][l];
    }
  for (int e = 0; e < 2; e++)
    for (int l = 0; l < LANES; l++) y[2 * (columns - 1) + e][l] /= root[l];
}

/* Keeps the residuals as they are, then weighs all columns for the robust loss. */
static inline void weigh(const struct arguments *a, int64_t first, int lanes, int columns, double (*y)[LANES]) {
  double r[2][LANES], s[LANES], w[LANES];
  for (int e = 0; e < 2; e++)
    for (int l = 0; l < LANES; l++) r[e][l] = y[2 * (columns - 1) + e][l];
  for (int l = 0; l < LANES; l++) s[l] = r[0][l] * r[0][l] + r[1][l] * r[1][l];
  for (int l = 0; l < LANES; l++) w[l] = weight(a->loss, a->scale, s[l]);
  for (int l = 0; l < lanes; l++) {
    a->squared[first + l] = s[l];
    for (int e = 0; e < 2; e++) a->residuals[e * a->n + a->row[first + l]] = r[e][l];
  }
  for (int k = 0; k < 2 * columns; k++)
    for (int l = 0; l < LANES; l++) y[k][l] *= w[l];
  if (a->curved) bend(a, columns, s, (const double(*)[LANES])r, y);
}

/* The rows [J_c r] of one projection. */
static inline void pack(const struct arguments *a, int64_t i, int l, int camera, const double (*y)[LANES]) {
  for (int e = 0; e < 2; e++) {
    double *packed = a->packed + a->place[e * a->n + i] * (camera + 1);
    for (int k = 0; k < camera; k++) packed[k] = y[2 * k + e][l];
    packed[camera] = y[2 * (camera + 1) + e][l];
  }
}

/* J_l' [J_c J_l r] of one projection, added to the rows of its landmark. */
static inline void add(const struct arguments *a, int64_t i, int l, int camera, const double (*y)[LANES]) {
  const double *depth = &y[2 * camera][l], *r = &y[2 * (camera + 1)][l];
  const int64_t m = a->landmark[i];
  a->h[m] += depth[0] * depth[0] + depth[LANES] * depth[LANES];
  a->g_l[m] += depth[0] * r[0] + depth[LANES] * r[LANES];
  for (int k = 0; k < camera; k++) {
    const double *column = &y[2 * k][l];
    a->W[m * a->width + a->start[k / TANGENT * a->n + i] + k % TANGENT] +=
        column[0] * depth[0] + column[LANES] * depth[LANES];
  }
}

static inline void project(const struct arguments *a, evaluate_fn *evaluate, int n_poses, int n_extrinsics, int n_td,
                           int n_data, int blocks) {
  const int camera = blocks * TANGENT + n_td; /* y: columns of camera blocks and td, the inverse depth, the residual */
  double x[MAX_BLOCKS * POSE + 2 + MAX_DATA][LANES], y[2 * (MAX_BLOCKS * TANGENT + 3)][LANES];
  for (int64_t first = 0; first < a->n; first += LANES) {
    const int lanes = a->n - first < LANES ? (int)(a->n - first) : LANES;
    gather(a, first, lanes, n_poses, n_extrinsics, n_td, n_data, x);
    evaluate(x, y);
    weigh(a, first, lanes, camera + 2, y);
    for (int l = 0; l < lanes; l++) {
      pack(a, first + l, l, camera, y);
      add(a, first + l, l, camera, y);
    }
  }
}

/* One entry for each residual and choice of free blocks: constant sizes let the compiler unroll. */
#define PROJECT(NAME, N_POSES, N_EXTRINSICS, N_TD, N_DATA, BLOCKS)                           \
  _Static_assert(N_POSES + N_EXTRINSICS <= MAX_BLOCKS && N_DATA <= MAX_DATA && BLOCKS <= MAX_BLOCKS, "too small"); \
  void project_##NAME(const struct arguments *a) { project(a, NAME, N_POSES, N_EXTRINSICS, N_TD, N_DATA, BLOCKS); }
