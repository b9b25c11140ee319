/** `report.json`, docs/formats/report.md. Older or other reports may lack keys: what is missing is not shown. */
import type { CostUnit } from "../placementdb/manifest";
import type { DeviceProfile, Settings } from "../api/schema";
import type { Box, Vec3, Verdict } from "../api/types";

export interface ReportStage {
  name: string;
  seconds: number;
  peak_bytes?: number;
  skipped: string | null;
  shards?: number;
  reused?: number;
}

export interface ReportView {
  problem_view: number;
  cell: number;
  interval: number;
  box: Box;
  position: Vec3;
  direction: Vec3;
  geometry_cost: number;
  cost_bound: number;
  impostors: number;
  hopeless?: boolean;
}

export interface Culprit {
  id: number;
  name: string;
  triangles: number;
  calls: number;
  hopeless_views?: number;
}

export interface HopelessView extends ReportView {
  best: number;
  culprits: Culprit[];
}

/** These bytes keep every problem view but `views_over` within `budget`. */
export interface CurvePoint {
  budget: number;
  bytes: number;
  views_over: number;
}

export interface Verified {
  views: number;
  over_budget: number;
  over_bound?: number;
  worst_ratio: number;
  worst_view: { position: Vec3; direction: Vec3; cost: number; cell?: number } | null;
  in_problem_views?: number;
  /** What a viewer holds at once in the cell that needs most; reports of before have none. */
  resident?: { cell: number; bytes: number; chunk_bytes: number; page_bytes: number; level_bytes: number; median_bytes: number; all_bytes: number };
}

export interface ProofPair {
  impostor: number;
  position: Vec3;
  direction: Vec3;
  crack_px: number;
  displacement_px: number;
  flip: number;
  flip_p95: number;
  pictures: { geometry: string; impostor: string; difference: string } | null;
}

export interface Proof {
  pairs: number;
  impostors: number;
  impostors_shown: number;
  failed: number;
  failed_impostors: number[];
  failing_share_upper: number;
  confidence: number;
  allowed_px: number | null;
  pixels: number;
  crack_px: number;
  worst_displacement_px: number;
  mean_displacement_px: number;
  pixels_in_view: number;
  flip: number;
  flip_p95: number;
  worst: ProofPair[];
  not_proven: string | null;
}

export interface ReportDevice extends DeviceProfile {
  name: string;
}

export interface Report {
  verdict: Verdict;
  stages: ReportStage[];
  version?: number;
  budget?: string;
  budget_amount?: number;
  unit?: CostUnit;
  device?: ReportDevice | null;
  smallest_budget?: { amount: number; text: string };
  objects?: number;
  triangles?: number;
  cells?: number;
  problem_views?: number;
  hopeless_views?: number;
  candidates?: number;
  detail?: { objects: number; levels: number; triangles: number; bytes: number; drawn_coarser: number; spared: number } | null;
  impostors?: number;
  layers?: number;
  chunks?: number;
  pages?: number;
  bytes?: number;
  file_bytes?: number;
  video_bytes?: number;
  lower_bound_bytes?: number | null;
  visibility?: {
    mode: string; rule: string; occluders?: string[]; seen_share: number | null; rays: number; held_out: number; held_out_missed: number;
    missed_ppm_upper: number | null; views: number; p99_ppm: number | null; worst_ppm: number | null; closed_cells: number; mean_objects: number;
  };
  bound?: { method: "lp" | "lagrangian"; estimated_bytes: number; gap: number | null; choices: number } | null;
  camera?: { fov_deg: number; width: number; height: number };
  quality?: { pixel_error: number; pixels_at: string };
  bounds?: Box | null;
  seconds?: number;
  peak_bytes?: number;
  seed?: number;
  settings?: Settings;
  worst_geometry_cost?: number;
  worst_cost_bound?: number;
  worst_views?: ReportView[];
  hopeless?: HopelessView[];
  culprits?: Culprit[];
  curve?: CurvePoint[];
  stopped?: boolean;
  verified?: Verified | null;
  proof?: Proof | null;
  warnings?: string[];
  dropped_triangles?: number;
  not_baked?: string[];
  left_out?: { need: string; why: string; stages: string[]; seconds: [number, number] | null; basis: string }[];
  looks?: { look: string; objects: number; geometry: number; flattened: number }[];
  software?: Record<string, unknown>;
  inputs?: Record<string, string>;
}
