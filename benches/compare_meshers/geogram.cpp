// Geogram's Delaunay triangulation of the points of a file: geogram FILE REPEAT THREADS
// Prints a line a repetition: points, tetrahedra, wall seconds, CPU seconds (of all threads).
#include <geogram/basic/command_line.h>
#include <geogram/basic/command_line_args.h>
#include <geogram/basic/logger.h>
#include <geogram/basic/process.h>
#include <geogram/delaunay/delaunay.h>
#include <sys/resource.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

static double cpu_seconds() {
  rusage use;
  getrusage(RUSAGE_SELF, &use);
  return use.ru_utime.tv_sec + use.ru_stime.tv_sec + 1e-6 * (use.ru_utime.tv_usec + use.ru_stime.tv_usec);
}

int main(int argc, char** argv) {
  if (argc != 4) return std::fprintf(stderr, "geogram FILE REPEAT THREADS\n"), 2;
  GEO::initialize();
  GEO::CmdLine::import_arg_group("standard");
  GEO::CmdLine::import_arg_group("algo");
  GEO::Logger::instance()->set_quiet(true);
  const int threads = std::atoi(argv[3]);
  GEO::Process::set_max_threads(threads);
  std::ifstream file(argv[1], std::ios::binary);
  std::vector<double> points;
  for (double c; file.read(reinterpret_cast<char*>(&c), sizeof c);) points.push_back(c);
  for (int i = 0; i < std::atoi(argv[2]); i++) {
    const double cpu = cpu_seconds();
    const auto start = std::chrono::steady_clock::now();
    GEO::Delaunay_var mesh = GEO::Delaunay::create(3, threads == 1 ? "BDEL" : "PDEL");
    mesh->set_vertices(points.size() / 3, points.data());
    const double wall = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::printf("%zu %zu %.4f %.4f\n", points.size() / 3, size_t(mesh->nb_cells()), wall, cpu_seconds() - cpu);
  }
  std::fflush(stdout);
  std::quick_exit(0);
}
