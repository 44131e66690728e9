// CGAL's Delaunay triangulation of the points of a file: cgal FILE REPEAT THREADS
// Prints a line a repetition: points, tetrahedra, wall seconds, CPU seconds (of all threads).
#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Delaunay_triangulation_cell_base_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_3.h>
#include <sys/resource.h>
#include <tbb/global_control.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Sequential = CGAL::Delaunay_triangulation_3<Kernel>;
using Parallel = CGAL::Delaunay_triangulation_3<
    Kernel, CGAL::Triangulation_data_structure_3<CGAL::Triangulation_vertex_base_3<Kernel>,
                                                 CGAL::Delaunay_triangulation_cell_base_3<Kernel>, CGAL::Parallel_tag>>;

static double cpu_seconds() {
  rusage use;
  getrusage(RUSAGE_SELF, &use);
  return use.ru_utime.tv_sec + use.ru_stime.tv_sec + 1e-6 * (use.ru_utime.tv_usec + use.ru_stime.tv_usec);
}

static size_t tetrahedra(const std::vector<Kernel::Point_3>& points, int threads) {
  if (threads == 1) return Sequential(points.begin(), points.end()).number_of_finite_cells();
  tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
  Parallel::Lock_data_structure locks(CGAL::Bbox_3(0, 0, 0, 1, 1, 1), 50);
  return Parallel(points.begin(), points.end(), &locks).number_of_finite_cells();
}

int main(int argc, char** argv) {
  if (argc != 4) return std::fprintf(stderr, "cgal FILE REPEAT THREADS\n"), 2;
  std::ifstream file(argv[1], std::ios::binary);
  std::vector<Kernel::Point_3> points;
  for (double p[3]; file.read(reinterpret_cast<char*>(p), sizeof p);) points.emplace_back(p[0], p[1], p[2]);
  for (int i = 0; i < std::atoi(argv[2]); i++) {
    const double cpu = cpu_seconds();
    const auto start = std::chrono::steady_clock::now();
    const size_t tets = tetrahedra(points, std::atoi(argv[3]));
    const double wall = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::printf("%zu %zu %.4f %.4f\n", points.size(), tets, wall, cpu_seconds() - cpu);
  }
}
