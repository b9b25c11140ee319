/** The index, kind `PlacementIndex`: cells, objects, clusters, impostor summaries (format section 3). */
import { ColumnReader, type Container } from "./columns";
import { ColumnsAltered } from "./errors";
import { DETAIL_VERSION, type Manifest } from "./manifest";

export interface PlacementIndex {
  nodeAxis: Int8Array;
  nodePlane: Float64Array;
  nodeLow: Int32Array;
  nodeHigh: Int32Array;
  nodeBox: Float64Array; // (K,2,3) relative to origin_m, as all boxes here
  nodeStart: Int32Array;
  cellNode: Int32Array;
  cellCost: Float64Array;
  viewBox: Float64Array;
  objectBox: Float64Array;
  objectCost: Float64Array; // without pixels
  objectCalls: Int32Array;
  objectTriangles: Int32Array;
  clusterStart: Int32Array;
  clusterStop: Int32Array;
  clusterLeft: Int32Array;
  clusterRight: Int32Array;
  clusterBox: Float64Array;
  impostorCluster: Int32Array;
  impostorKind: Uint8Array;
  impostorViewCell: Float64Array; // (I,9)
  impostorBytes: Float64Array;
  impostorCost: Float64Array;
  impostorTriangles: Int32Array;
  impostorLayers: Int32Array;
  impostorChunk: Int32Array;
  // Coarser levels of object o: rows [levelRow[o], levelRow[o+1]). All empty where no object has any.
  levelRow: Int32Array;
  levelFrom: Float64Array; // least distance from a cell, metres
  levelCost: Float64Array;
  levelTriangles: Int32Array;
}

export function readIndex(container: Container, where: string, manifest: Manifest): PlacementIndex {
  if (container.kind !== "PlacementIndex") throw new ColumnsAltered(where, `it holds ${container.kind}, not PlacementIndex`);
  const r = new ColumnReader(container, where);
  const { nodes: K, cells: L, objects: N, clusters: C, impostors: I } = manifest.counts;
  const detailed = r.length("level_row") > 0;
  if (!detailed && manifest.version === DETAIL_VERSION) throw new ColumnsAltered(where, "column level_row is not there");
  const index: PlacementIndex = {
    nodeAxis: r.i1("node_axis", K),
    nodePlane: r.f8("node_plane", K),
    nodeLow: r.i4("node_low", K),
    nodeHigh: r.i4("node_high", K),
    nodeBox: r.f8("node_box", K, 2, 3),
    nodeStart: r.ids("node_start", r.i4("node_start", K), 0, L),
    cellNode: r.ids("cell_node", r.i4("cell_node", L), 0, K),
    cellCost: r.i8("cell_cost", L),
    viewBox: r.f8("view_box", manifest.view_space.length, 2, 3),
    objectBox: r.f8("object_box", N, 2, 3),
    objectCost: r.i8("object_cost", N),
    objectCalls: r.i4("object_calls", N),
    objectTriangles: r.i4("object_triangles", N),
    clusterStart: r.i4("cluster_start", C),
    clusterStop: r.i4("cluster_stop", C),
    clusterLeft: r.i4("cluster_left", C),
    clusterRight: r.i4("cluster_right", C),
    clusterBox: r.f8("cluster_box", C, 2, 3),
    impostorCluster: r.ids("impostor_cluster", r.i4("impostor_cluster", I), 0, C),
    impostorKind: r.u1("impostor_kind", I),
    impostorViewCell: r.f8("impostor_view_cell", I, 9),
    impostorBytes: r.i8("impostor_bytes", I),
    impostorCost: r.i8("impostor_cost", I),
    impostorTriangles: r.i4("impostor_triangles", I),
    impostorLayers: r.i4("impostor_layers", I),
    impostorChunk: r.ids("impostor_chunk", r.i4("impostor_chunk", I), -1, manifest.chunks.length),
    levelRow: detailed ? r.rows("level_row", r.i4("level_row", N + 1), r.length("level_from")) : new Int32Array(0),
    levelFrom: detailed ? r.f8("level_from", null) : new Float64Array(0),
    levelCost: detailed ? r.i8("level_cost", r.length("level_from")) : new Float64Array(0),
    levelTriangles: detailed ? r.i4("level_triangles", r.length("level_from")) : new Int32Array(0),
  };
  // Preorder: a child follows its parent, so that no walk down the tree can loop.
  for (let k = 0; k < K; k++) {
    const inner = index.nodeAxis[k] >= 0;
    const low = index.nodeLow[k];
    const high = index.nodeHigh[k];
    if (index.nodeAxis[k] > 2 || (inner && !(low > k && low < K && high > k && high < K))) {
      throw new ColumnsAltered(where, `node ${k} has impossible children`);
    }
  }
  for (let c = 0; c < C; c++) {
    const left = index.clusterLeft[c];
    const right = index.clusterRight[c];
    const inner = left >= 0 && left > c && left < C && right > c && right < C;
    const range = index.clusterStart[c] >= 0 && index.clusterStart[c] <= index.clusterStop[c] && index.clusterStop[c] <= N;
    if (!range || (left >= 0 && !inner)) throw new ColumnsAltered(where, `cluster ${c} has an impossible range or children`);
  }
  return index;
}
