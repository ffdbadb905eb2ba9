// make_golden OUT_PREFIX: a small map made by OctoMap itself, as .ot, .bt and a list of its leaves.
// The list has one line per leaf: key of its first cell (x y z, signed), edge in cells, log-odds.
#include <octomap/octomap.h>
#include <cstdio>
#include <random>
using namespace octomap;
int main(int, char** v) {
  OcTree tree(0.1); std::mt19937 random(5); std::string prefix = v[1];
  auto uniform = [&](double a, double b) { return a + (b - a) * (random() / 4294967296.0); };
  // A free block that prunes to large leaves, on both sides of the origin, and nowhere symmetric.
  for (int x = -16; x < 8; ++x) for (int y = -8; y < 16; ++y) for (int z = 0; z < 8; ++z)
    tree.updateNode(OcTreeKey(32768 + x, 32768 + y, 32768 + z), -5.f);
  // Rays, hits and values of every size, clamped by OctoMap.
  for (int i = 0; i < 25; ++i) tree.insertRay(point3d(0.33f, -0.21f, 0.5f), point3d(uniform(-2, 3), uniform(-1, 2), uniform(-1, 1)));
  for (int i = 0; i < 300; ++i) tree.updateNode(point3d(uniform(-2, 3), uniform(-1, 2), uniform(-1, 1)), (float)uniform(-3, 5));
  tree.updateNode(point3d(-3276.75f, 3276.75f, -0.05f), true);
  tree.prune(); tree.write(prefix + ".ot");
  FILE* list = fopen((prefix + ".txt").c_str(), "w");
  for (auto it = tree.begin_leafs(); it != tree.end_leafs(); ++it) {
    OcTreeKey key = it.getIndexKey(); int edge = 1 << (16 - it.getDepth());
    fprintf(list, "%d %d %d %d %.9g\n", key[0] - 32768, key[1] - 32768, key[2] - 32768, edge, it->getLogOdds());
  }
  fclose(list); tree.writeBinary(prefix + ".bt"); printf("%zu leaves\n", tree.getNumLeafNodes());
}
