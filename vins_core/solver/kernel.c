/* The projections of a window in one pass: evaluate, weigh, add up what the inverse depths see.
 *
 * Compiled together with `evaluate` functions that are generated from the CasADi residuals (factors/c_source.py), and
 * called through ctypes (compiled_rows.py).  Each operation is rounded by itself and every sum runs in the order in
 * which NumpyRows (visual_rows.py) adds it up, so both give the same bits.
 */
#include <math.h>
#include <stdint.h>

enum { LANES = 64 }; /* projections evaluated together */
enum { POSE = 7, TANGENT = 6, MAX_DATA = 16, MAX_BLOCKS = 3 };
enum loss { NONE, CAUCHY, HUBER };

typedef void evaluate_fn(const double (*restrict x)[LANES], double (*restrict y)[LANES]);

/* Mirrored by compiled_rows.Arguments.  Matrices are row-major. */
struct arguments {
  /* the window's structure */
  int64_t n;               /* projections */
  int64_t width;           /* columns of W */
  int64_t loss;            /* enum loss */
  double scale;            /* of the loss */
  const int64_t *anchor;   /* (n,) row of poses */
  const int64_t *observer; /* (n,) row of poses */
  const int64_t *landmark; /* (n,) row of W */
  const int64_t *start;    /* (blocks, n) first column in W of each camera block */
  const int64_t *place;    /* (2, n) row of `packed` for both rows of a projection */
  const int64_t *row;      /* (n,) column of `residuals` */
  const double *data;      /* (n_data, n) */
  /* the states */
  const double *poses;      /* (frames, 7) */
  const double *extrinsic;  /* (7,) */
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

static inline void project(const struct arguments *a, evaluate_fn *evaluate, int n_data, int blocks) {
  const int camera = blocks * TANGENT; /* columns of J: those of the camera blocks, the inverse depth, the residual */
  const int64_t n = a->n;
  double x[3 * POSE + 1 + MAX_DATA][LANES], y[2 * (MAX_BLOCKS * TANGENT + 2)][LANES], s[LANES], w[LANES];
  for (int64_t first = 0; first < n; first += LANES) {
    const int lanes = n - first < LANES ? (int)(n - first) : LANES;
    for (int l = 0; l < LANES; l++) { /* spare lanes repeat the last projection */
      const int64_t i = first + (l < lanes ? l : lanes - 1);
      for (int k = 0; k < POSE; k++) {
        x[k][l] = a->poses[a->anchor[i] * POSE + k];
        x[POSE + k][l] = a->poses[a->observer[i] * POSE + k];
        x[2 * POSE + k][l] = a->extrinsic[k];
      }
      x[3 * POSE][l] = a->inv_depths[a->landmark[i]];
      for (int k = 0; k < n_data; k++) x[3 * POSE + 1 + k][l] = a->data[k * n + i];
    }
    evaluate(x, y);

    const double(*depth)[LANES] = y + 2 * camera, (*r)[LANES] = y + 2 * (camera + 1);
    for (int l = 0; l < LANES; l++) s[l] = r[0][l] * r[0][l] + r[1][l] * r[1][l];
    for (int l = 0; l < LANES; l++) w[l] = weight(a->loss, a->scale, s[l]);
    for (int l = 0; l < lanes; l++) {
      const int64_t i = first + l;
      a->residuals[a->row[i]] = r[0][l];
      a->residuals[n + a->row[i]] = r[1][l];
      a->squared[i] = s[l];
    }
    for (int k = 0; k < 2 * (camera + 2); k++)
      for (int l = 0; l < LANES; l++) y[k][l] *= w[l];

    for (int l = 0; l < lanes; l++)
      for (int e = 0; e < 2; e++) {
        double *packed = a->packed + a->place[e * n + first + l] * (camera + 1);
        for (int k = 0; k < camera; k++) packed[k] = y[2 * k + e][l];
        packed[camera] = r[e][l];
      }
    for (int l = 0; l < lanes; l++) {
      const int64_t i = first + l, m = a->landmark[i];
      a->h[m] += depth[0][l] * depth[0][l] + depth[1][l] * depth[1][l];
      a->g_l[m] += depth[0][l] * r[0][l] + depth[1][l] * r[1][l];
      for (int b = 0; b < blocks; b++) {
        double *entry = a->W + m * a->width + a->start[b * n + i];
        for (int k = 0; k < TANGENT; k++) {
          const double(*column)[LANES] = y + 2 * (TANGENT * b + k);
          entry[k] += column[0][l] * depth[0][l] + column[1][l] * depth[1][l];
        }
      }
    }
  }
}

/* One entry for each residual and choice of free blocks: constant sizes let the compiler unroll. */
#define PROJECT(NAME, N_DATA, BLOCKS) \
  void project_##NAME(const struct arguments *a) { project(a, NAME, N_DATA, BLOCKS); }
