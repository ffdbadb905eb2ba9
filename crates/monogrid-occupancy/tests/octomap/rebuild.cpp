// rebuild CELLS.txt RESOLUTION OUT.ot: a map rebuilt cell by cell with OctoMap from "x y z log_odds" lines (cell centres).
#include <octomap/octomap.h>
#include <fstream>
int main(int, char** v) {
  octomap::OcTree tree(atof(v[2])); std::ifstream in(v[1]); double x, y, z; float log_odds;
  while (in >> x >> y >> z >> log_odds) tree.setNodeValue(octomap::point3d(x, y, z), log_odds, true);
  tree.updateInnerOccupancy(); tree.prune(); tree.write(v[3]); printf("%zu leaves\n", tree.getNumLeafNodes());
}
