/** The shaders of everything that is lit and coloured as level geometry. */

import fragmentSource from "./mesh.fragment.glsl?raw";
import meshSource from "./mesh.vertex.glsl?raw";
import surfaceSource from "./surface.glsl?raw";

/** Return a vertex shader whose line SURFACE stands for `surface()` and what it hands to the fragments. */
export function withSurface(vertexSource: string): string {
  return vertexSource.replace("SURFACE", surfaceSource);
}

export const MESH_SHADERS = { vertexShader: withSurface(meshSource), fragmentShader: fragmentSource };
