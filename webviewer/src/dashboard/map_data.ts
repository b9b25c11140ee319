/** What the map of the view space shows: of a finished placement from its files, of a running job from what it tells. */
import type { Report } from "./report_types";
import type { Box, LiveMap } from "../api/types";
import { Placement } from "../placementdb/placement";
import { fetchFrom, makeTraffic } from "../stream/files";
import { addView, emptyHistogram, type Histogram } from "./histogram";

export interface MapCell {
  box: Box;
  cost: number; // worst bound of its views as geometry, per_frame included
  cell: number;
  views: number; // problem views; -1: not known
  hopeless: number;
  unsolved: number; // problem views; -1: not known
}

export interface MapData {
  cells: MapCell[];
  footprints: Box[];
  budget: number;
  unit: string;
  views: Histogram | null; // null: there are too many to read them all
  complete: boolean; // false: hopeless views were read from the report alone, which lists the worst
}

const CHUNK_BYTES = 32e6; // hopeless cells are not worth more than that to a page

/** Reads what the map shows of a placement. */
export async function readMap(placement: string, report: Report): Promise<MapData> {
  const p = await Placement.open(fetchFrom(`/v1/placements/${encodeURIComponent(placement)}/`, makeTraffic()));
  const { manifest, index } = p;
  const box = (from: Float64Array, k: number): Box => {
    const at = (i: number): number => from[6 * k + i] + manifest.origin_m[i % 3];
    return [[at(0), at(1), at(2)], [at(3), at(4), at(5)]];
  };
  const cells: MapCell[] = Array.from(index.cellNode, (node, cell) => ({
    box: box(index.nodeBox, node), cost: index.cellCost[cell] + manifest.cost_model.per_frame, cell, views: 0, hopeless: 0, unsolved: -1,
  }));
  const hopeless = manifest.counts.hopeless_views;
  const size = manifest.chunks.reduce((sum, c) => sum + c.bytes, 0);
  const listed = report.hopeless?.length ?? 0;
  const complete = hopeless <= listed || size <= CHUNK_BYTES;
  let views: Histogram | null = null;
  if (size <= CHUNK_BYTES) {
    views = emptyHistogram();
    const fixed = manifest.cost_model.per_frame;
    for (let k = 0; k < manifest.chunks.length; k++) {
      const chunk = await p.chunk(k);
      for (let c = chunk.cells[0]; c < chunk.cells[1]; c++) {
        const [a, b] = [chunk.cellView[c - chunk.cells[0]], chunk.cellView[c - chunk.cells[0] + 1]];
        cells[c].views = b - a;
        for (let v = a; v < b; v++) {
          cells[c].hopeless += chunk.viewHopeless[v];
          addView(views, chunk.viewGeometryCost[v] + fixed, chunk.viewCost[v] + fixed, manifest.budget.amount);
        }
      }
      p.dropChunk(k);
    }
  } else {
    for (const c of cells) c.views = -1;
    for (const view of report.hopeless ?? []) if (cells[view.cell]) cells[view.cell].hopeless++;
  }
  const footprints = Array.from({ length: manifest.counts.objects }, (_, k) => box(index.objectBox, k));
  return { cells, footprints, budget: manifest.budget.amount, unit: manifest.budget.unit, views, complete };
}

/** Tiles of a job that has no placement yet: the view space without heights. */
export function liveMapData(map: LiveMap, footprints: Box[]): MapData {
  const { boxes } = map;
  const cells = map.cost.map((cost, k): MapCell => ({
    box: [[boxes[4 * k], 0, boxes[4 * k + 1]], [boxes[4 * k + 2], 0, boxes[4 * k + 3]]], cost, cell: k, views: map.views[k], hopeless: 0, unsolved: -1,
  }));
  return { cells, footprints, budget: map.budget, unit: map.unit, views: null, complete: true };
}
