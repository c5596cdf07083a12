// What the page takes of three.js and uPlot; README.md beside says how library.min.js is made of it.
export {
  ACESFilmicToneMapping, BufferAttribute, BufferGeometry, CanvasTexture, Color, ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide,
  Group, HemisphereLight, Mesh, MeshPhongMaterial, MeshStandardMaterial, PCFShadowMap, PerspectiveCamera, PMREMGenerator, Points, PointsMaterial, Quaternion, Scene,
  ShaderMaterial, SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { RoomEnvironment } from "three/examples/jsm/environments/RoomEnvironment.js";
export { toCreasedNormals } from "three/examples/jsm/utils/BufferGeometryUtils.js";
export { default as uPlot } from "uplot";
