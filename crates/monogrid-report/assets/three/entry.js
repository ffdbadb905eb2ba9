export {
  BufferAttribute, BufferGeometry, Float32BufferAttribute, Group,
  InterleavedBuffer, InterleavedBufferAttribute, Line, LineBasicMaterial, LineSegments, Matrix4, Mesh, PerspectiveCamera, Points, Raycaster,
  Scene, ShaderMaterial, Texture, Vector2, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
