// ask MAP.ot|MAP.bt < POINTS: prints per line "x y z" what OctoMap finds there: unknown, free or occupied.
#include <octomap/octomap.h>
#include <iostream>
#include <memory>
int main(int, char** v) {
  std::string name = v[1]; std::unique_ptr<octomap::OcTree> tree;
  if (name.substr(name.size() - 3) == ".bt") tree.reset(new octomap::OcTree(name)); else tree.reset(dynamic_cast<octomap::OcTree*>(octomap::AbstractOcTree::read(name)));
  double x, y, z;
  while (std::cin >> x >> y >> z) { auto* node = tree->search(x, y, z); printf("%g %g %g %s\n", x, y, z, !node ? "unknown" : tree->isNodeOccupied(node) ? "occupied" : "free"); }
}
