// query MAP.ot QUESTIONS.bin: speed of OctoMap's search and castRay on the questions that the example
// `query_speed` wrote (u64 points, u64 rays; f64 x 3 per point; origin and direction per ray).
#include <octomap/octomap.h>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <memory>
#include <vector>
static double cpu() { timespec t; clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }
template <class F> static double best(F work, int repeats) {
  double least = 1e300;
  for (int i = 0; i < repeats; ++i) { double start = cpu(); work(); least = std::min(least, cpu() - start); }
  return least;
}
int main(int, char** v) {
  std::unique_ptr<octomap::OcTree> tree(dynamic_cast<octomap::OcTree*>(octomap::AbstractOcTree::read(v[1])));
  std::ifstream in(v[2], std::ios::binary);
  uint64_t counts[2]; in.read((char*)counts, sizeof counts);
  std::vector<double> numbers(3 * counts[0] + 6 * counts[1]);
  in.read((char*)numbers.data(), numbers.size() * sizeof(double));
  std::vector<octomap::point3d> points(counts[0] + 2 * counts[1]);
  for (size_t i = 0; i < points.size(); ++i) points[i] = octomap::point3d(numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]);
  long states[3] = {0, 0, 0};
  double seconds = best([&] {
    std::fill(states, states + 3, 0);
    for (size_t i = 0; i < counts[0]; ++i) { auto* node = tree->search(points[i]); ++states[!node ? 0 : tree->isNodeOccupied(node) ? 2 : 1]; }
  }, 3);
  printf("search     %8.2f M/s  unknown, free, occupied [%ld, %ld, %ld]\n", counts[0] / seconds * 1e-6, states[0], states[1], states[2]);
  for (bool through : {true, false}) {
    long hits = 0; double ranges = 0;
    seconds = best([&] {
      hits = 0; ranges = 0;
      for (size_t i = 0; i < counts[1]; ++i) {
        auto &origin = points[counts[0] + 2 * i], &direction = points[counts[0] + 2 * i + 1]; octomap::point3d end;
        if (tree->castRay(origin, direction, end, through, 10.0)) { ++hits; ranges += (end - origin).norm(); }
      }
    }, 2);
    printf("castRay    %8.3f M/s  %s: %ld of %lu hit, mean range %.3f\n", counts[1] / seconds * 1e-6, through ? "through unknown" : "to unknown", hits, (unsigned long)counts[1], ranges / std::max(hits, 1l));
  }
}
