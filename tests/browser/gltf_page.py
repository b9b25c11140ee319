"""three.js and its own GLTFLoader on a page: pictures of exported files, served from node_modules."""

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from pathlib import Path

from browser.static_server import ROOT, listening

THREE = ROOT / "webviewer" / "node_modules" / "three"
PAGE = b"""<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
const scene = new THREE.Scene();
window.load = async (url) => {
  const gltf = await new GLTFLoader().loadAsync(url);
  scene.clear();
  scene.add(gltf.scene);
  const kinds = new Set();
  gltf.scene.traverse((o) => o.isMesh && kinds.add(o.material.type + " " + o.material.alphaTest));
  return { kinds: [...kinds], scenes: gltf.scenes.length };
};
window.shoot = ({ position, direction, fov, width, height, background }) => {
  renderer.setSize(width, height, false);
  const camera = new THREE.PerspectiveCamera(fov, width / height, 0.1, 100000);
  camera.position.set(...position);
  camera.lookAt(position[0] + direction[0], position[1] + direction[1], position[2] + direction[2]);
  scene.background = new THREE.Color(background, background, background);
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL("image/png");
};
window.started = true;
</script>"""
TYPES = {".js": "text/javascript", ".glb": "model/gltf-binary", ".gltf": "model/gltf+json", ".png": "image/png"}


@contextmanager
def serving_gltf(folder: Path) -> Iterator[str]:
    """Serve the page at / and the folder's files at /files while the context lasts; yields the address."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            parts = self.path.split("?")[0].strip("/").split("/")
            roots = {"three": THREE, "files": folder}
            found = roots[parts[0]].joinpath(*parts[1:]) if parts[0] in roots and ".." not in parts else None
            content = found.read_bytes() if found and found.is_file() else PAGE if parts == [""] else None
            self.send_response(404 if content is None else 200)
            kind = TYPES.get(found.suffix, "application/octet-stream") if found else "text/html"
            self.send_header("content-type", kind)
            self.send_header("content-length", str(len(content or b"")))
            self.end_headers()
            self.wfile.write(content or b"")

        def log_message(self, *_: object) -> None:
            pass

    with listening(Handler) as url:
        yield url
