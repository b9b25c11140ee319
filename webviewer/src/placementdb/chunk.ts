/** A chunk, kind `PlacementChunk`: what the cells of one subtree of the view space show (format section 4). */
import { ColumnReader, type Container } from "./columns";
import { ColumnsAltered } from "./errors";
import type { Manifest } from "./manifest";

export interface PlacementChunk {
  number: number;
  cells: [number, number];
  views: [number, number];
  cellView: Int32Array;
  cellVisible: Int32Array; // empty with visibility off
  visibleRow: Int32Array;
  visibleObject: Int32Array;
  viewInterval: Int32Array;
  viewCost: Float64Array;
  viewGeometryCost: Float64Array;
  viewHopeless: Uint8Array;
  viewList: Int32Array;
  listRow: Int32Array;
  listImpostor: Int32Array; // local rows of the tables below
  impostorId: Int32Array;
  impostorEye: Float64Array;
  impostorRight: Float64Array;
  impostorUp: Float64Array;
  impostorLayer: Int32Array;
  layerNumber: Uint16Array;
  layerPlane: Float64Array;
  layerInverseNear: Float64Array;
  layerInverseFar: Float64Array;
  layerPage: Int32Array;
  layerRect: Uint16Array;
  layerCorner: Int32Array;
  cornerPosition: Float32Array; // relative to the impostor's eye
  cornerUv: Float32Array; // texels of level 0
}

export function readChunk(container: Container, where: string, manifest: Manifest, number: number): PlacementChunk {
  if (container.kind !== "PlacementChunk") throw new ColumnsAltered(where, `it holds ${container.kind}, not PlacementChunk`);
  const entry = manifest.chunks[number];
  const { meta } = container;
  if (meta.chunk !== number || `${meta.cells}` !== `${entry.cells}` || `${meta.views}` !== `${entry.views}`) {
    throw new ColumnsAltered(where, `it is not chunk ${number}, cells ${entry.cells[0]} to ${entry.cells[1]}`);
  }
  const r = new ColumnReader(container, where);
  const n = entry.cells[1] - entry.cells[0];
  const V = entry.views[1] - entry.views[0];
  const M = r.length("impostor_id");
  const R = r.length("layer_number");
  const Q = r.length("corner_uv");
  const lists = r.length("list_row");
  const S = Math.max(0, lists - 1);
  const E = r.length("visible_object");
  const Z = Math.max(0, r.length("visible_row") - 1);
  const hasVisible = r.length("cell_visible") > 0;
  const { objects: N, impostors: I } = manifest.counts;
  const chunk: PlacementChunk = {
    number,
    cells: entry.cells,
    views: entry.views,
    cellView: r.rows("cell_view", r.i4("cell_view", n + 1), V),
    cellVisible: hasVisible ? r.ids("cell_visible", r.i4("cell_visible", n), 0, Z) : r.i4("cell_visible", 0),
    visibleRow: hasVisible ? r.rows("visible_row", r.i4("visible_row", null), E) : r.i4("visible_row", null),
    visibleObject: r.ids("visible_object", r.i4("visible_object", E), 0, N),
    viewInterval: r.i4("view_interval", V),
    viewCost: r.i8("view_cost", V),
    viewGeometryCost: r.i8("view_geometry_cost", V),
    viewHopeless: r.u1("view_hopeless", V),
    viewList: r.ids("view_list", r.i4("view_list", V), 0, S),
    listRow: r.rows("list_row", r.i4("list_row", S + 1), r.length("list_impostor")),
    listImpostor: r.ids("list_impostor", r.i4("list_impostor", null), 0, M),
    impostorId: r.ids("impostor_id", r.i4("impostor_id", M), 0, I),
    impostorEye: r.f8("impostor_eye", M, 3),
    impostorRight: r.f8("impostor_right", M, 3),
    impostorUp: r.f8("impostor_up", M, 3),
    impostorLayer: r.rows("impostor_layer", r.i4("impostor_layer", M + 1), R),
    layerNumber: r.u2("layer_number", R),
    layerPlane: r.f8("layer_plane", R),
    layerInverseNear: r.f8("layer_inverse_near", R),
    layerInverseFar: r.f8("layer_inverse_far", R),
    layerPage: r.ids("layer_page", r.i4("layer_page", R), 0, manifest.pages.length),
    layerRect: r.u2("layer_rect", R, 4),
    layerCorner: r.rows("layer_corner", r.i4("layer_corner", R + 1), Q),
    cornerPosition: r.f4("corner_position", Q, 3),
    cornerUv: r.f4("corner_uv", Q, 2),
  };
  for (let row = 0; row < R; row++) {
    const corners = chunk.layerCorner[row + 1] - chunk.layerCorner[row];
    const [x, y, w, h] = chunk.layerRect.subarray(4 * row, 4 * row + 4);
    if (corners < 3 || corners > 8 || x + w > manifest.page.size || y + h > manifest.page.size) {
      throw new ColumnsAltered(where, `layer row ${row} has impossible corners or texels`);
    }
  }
  return chunk;
}
