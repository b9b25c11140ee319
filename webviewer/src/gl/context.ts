/** The one WebGL2 context, its programs, and what it can do. */

export class NoWebGl2 extends Error {
  constructor() {
    super("This browser or graphics driver offers no WebGL 2.");
  }
}

export function makeContext(canvas: HTMLCanvasElement): WebGL2RenderingContext {
  const gl = canvas.getContext("webgl2", {
    // Impostors write depth per fragment and are cut out per texel: multisampling would smooth geometry only.
    alpha: false, antialias: false, depth: true, stencil: false, powerPreference: "high-performance", preserveDrawingBuffer: false,
  });
  if (!gl) throw new NoWebGl2();
  return gl;
}

interface GpuTimer {
  TIME_ELAPSED_EXT: number;
  GPU_DISJOINT_EXT: number;
}

/** The GPU's own timer; null where the browser offers none. */
export function gpuTimer(gl: WebGL2RenderingContext): GpuTimer | null {
  return gl.getExtension("EXT_disjoint_timer_query_webgl2") as GpuTimer | null;
}

export interface Program {
  handle: WebGLProgram;
  uniform: (name: string) => WebGLUniformLocation | null;
}

export function makeProgram(gl: WebGL2RenderingContext, vertex: string, fragment: string): Program {
  const handle = gl.createProgram()!;
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(`a shader does not compile: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.attachShader(handle, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`a program does not link: ${gl.getProgramInfoLog(handle)}`);
  }
  const known = new Map<string, WebGLUniformLocation | null>();
  return {
    handle,
    uniform: (name) => {
      if (!known.has(name)) known.set(name, gl.getUniformLocation(handle, name));
      return known.get(name)!;
    },
  };
}
