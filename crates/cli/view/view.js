// Shows a baked scene: scene.glb, manifest.json and light maps from the folder of this page, or from a folder that the user picks
// (browsers let no page opened as a file read its neighbours).
//
// The query part of the address sets up a picture: ?camera=0&exposure=1&show=light&tone=none&panel=0
import {
  AgXToneMapping, ACESFilmicToneMapping, Box3, Color, DataTexture, DoubleSide, LinearFilter, MeshLambertMaterial, NearestFilter,
  NeutralToneMapping, NoToneMapping, PerspectiveCamera, ReinhardToneMapping, RepeatWrapping, Scene, SRGBColorSpace, Vector3,
  WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { EXRLoader } from 'three/examples/jsm/loaders/EXRLoader.js';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { MeshoptDecoder } from 'three/examples/jsm/libs/meshopt_decoder.module.js';

const find = (id) => document.getElementById(id);
const asked = new URLSearchParams(location.search);
const tones = { neutral: NeutralToneMapping, agx: AgXToneMapping, aces: ACESFilmicToneMapping, reinhard: ReinhardToneMapping, none: NoToneMapping };

/** Bytes of a file of the output folder, by name. */
let read = async (name) => {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
  return answer.arrayBuffer();
};

function say(text) {
  find('text').textContent = text;
  find('message').hidden = text === '';
}

/** The folder that the user picks, in place of the page's own. */
function pickFolder() {
  say('Opened as a file, this page cannot read what lies beside it.\nPick its folder here, or serve it, for example: python3 -m http.server');
  const input = find('files');
  input.hidden = false;
  return new Promise((done) => input.addEventListener('change', () => {
    const files = new Map([...input.files].map((file) => [file.name, file]));
    read = async (name) => {
      const file = files.get(name);
      if (!file) throw new Error(`${name} is not in this folder`);
      return file.arrayBuffer();
    };
    done();
  }, { once: true }));
}

/** A page of light maps. EXRLoader stores rows bottom up: v is turned where the map is placed. */
async function readPage(page) {
  const texture = new EXRLoader().parse(await read(page.file));
  const map = new DataTexture(texture.data, texture.width, texture.height, texture.format, texture.type);
  map.minFilter = map.magFilter = LinearFilter;
  map.needsUpdate = true;
  return map;
}

/** The map as one node sees it. */
function place(map, node) {
  const placed = map.clone();
  placed.channel = 1;
  placed.needsUpdate = true;
  placed.repeat.set(node.scale[0], -node.scale[1]);
  placed.offset.set(node.offset[0], 1 - node.offset[1]);
  return placed;
}

/** A Lambert surface in baked light. */
function litMaterial(source, lightMap, intensity) {
  return new MeshLambertMaterial({
    name: source.name,
    color: source.color ?? new Color(1, 1, 1),
    map: source.map ?? null,
    emissive: source.emissive ?? new Color(0, 0, 0),
    emissiveMap: source.emissiveMap ?? null,
    emissiveIntensity: source.emissiveIntensity ?? 1,
    vertexColors: source.vertexColors,
    alphaTest: source.alphaTest,
    alphaMap: source.alphaMap ?? null,
    transparent: source.transparent,
    opacity: source.opacity,
    flatShading: source.flatShading,
    side: DoubleSide,
    lightMap,
    lightMapIntensity: intensity,
  });
}

/** Squares of 8 x 8 texels. */
function checker() {
  const map = new DataTexture(new Uint8Array([255, 255, 255, 255, 40, 40, 40, 255, 40, 40, 40, 255, 255, 255, 255, 255]), 2, 2);
  map.magFilter = NearestFilter;
  map.wrapS = map.wrapT = RepeatWrapping;
  map.needsUpdate = true;
  return map;
}

async function start() {
  if (location.protocol === 'file:') await pickFolder();
  say('Loading…');
  const manifest = JSON.parse(new TextDecoder().decode(await read('manifest.json')));
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  const [gltf, ...pages] = await Promise.all([
    read('scene.glb').then((bytes) => loader.parseAsync(bytes, '')),
    ...manifest.pages.map(readPage),
  ]);
  // A Lambert shader divides by pi; maps that hold irradiance / pi have that behind them.
  const intensity = manifest.quantity === 'irradiance' ? 1 : Math.PI;

  const nodeOf = (object) => {
    for (let at = object; at; at = at.parent) {
      const index = gltf.parser.associations.get(at)?.nodes;
      if (index !== undefined) return index;
    }
    return undefined;
  };
  const variants = [];
  const made = new Map();
  gltf.scene.traverse((object) => {
    if (object.isLight) object.visible = false;
    if (!object.isMesh) return;
    const index = nodeOf(object);
    // Of many instances in one node only the first one's rectangle is shown: three.js has one material for all.
    const node = manifest.nodes.find((entry) => entry.node === index);
    const lit = node && object.geometry.attributes.uv1 && pages[node.page];
    const key = `${object.material.uuid} ${lit ? index : ''}`;
    if (!made.has(key)) {
      const map = lit ? place(pages[node.page], node) : null;
      const material = litMaterial(object.material, map, intensity);
      if (!map) material.color.setScalar(0);
      made.set(key, { material, color: material.color.clone(), map: material.map, emissive: material.emissive.clone(), lightMap: map, node });
      variants.push(made.get(key));
    }
    object.material = made.get(key).material;
  });

  const scene = new Scene();
  scene.add(gltf.scene);
  scene.updateMatrixWorld(true);

  const renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.outputColorSpace = SRGBColorSpace;
  renderer.toneMapping = tones[asked.get('tone') ?? 'neutral'] ?? NeutralToneMapping;
  renderer.setPixelRatio(asked.has('panel') ? 1 : devicePixelRatio);
  document.body.append(renderer.domElement);
  const box = new Box3().setFromObject(gltf.scene);
  const size = box.getSize(new Vector3()).length() || 1;
  const camera = new PerspectiveCamera(50, 1, size * 1e-4, size * 4);
  const controls = new OrbitControls(camera, renderer.domElement);

  const look = (index) => {
    const from = gltf.cameras[index];
    if (from?.isPerspectiveCamera) {
      from.matrixWorld.decompose(camera.position, camera.quaternion, new Vector3());
      camera.fov = from.fov;
      const ahead = new Vector3(0, 0, -0.25 * size).applyQuaternion(camera.quaternion);
      controls.target.copy(camera.position).add(ahead);
    } else {
      const centre = box.getCenter(new Vector3());
      camera.position.copy(centre).add(new Vector3(0.5, 0.35, 0.8).multiplyScalar(0.8 * size));
      controls.target.copy(centre);
    }
    camera.updateProjectionMatrix();
    camera.lookAt(controls.target);
    controls.update();
  };
  const draw = () => renderer.render(scene, camera);
  const resize = () => {
    renderer.setSize(innerWidth, innerHeight);
    camera.aspect = innerWidth / innerHeight;
    camera.updateProjectionMatrix();
    draw();
  };
  const texels = checker();
  const show = (what) => {
    for (const { material, color, map, emissive, lightMap, node } of variants) {
      const plain = what !== 'lit';
      material.color.copy(plain && lightMap ? new Color(1, 1, 1) : color);
      material.map = plain ? null : map;
      material.emissive.copy(plain ? new Color(0, 0, 0) : emissive);
      if (what === 'texels' && lightMap) {
        const page = manifest.pages[node.page];
        material.map = texels.clone();
        material.map.needsUpdate = true;
        material.map.channel = 1;
        material.map.repeat.set(node.scale[0] * page.width / 16, node.scale[1] * page.height / 16);
        material.map.offset.set(node.offset[0] * page.width / 16, node.offset[1] * page.height / 16);
      }
      material.needsUpdate = true;
    }
    draw();
  };
  const expose = (stops) => { renderer.toneMappingExposure = 2 ** stops; draw(); };

  for (const [index, from] of [...gltf.cameras, { name: 'whole scene' }].entries()) {
    find('camera').add(new Option(from.name || `camera ${index}`, index));
  }
  find('camera').addEventListener('change', (event) => { look(Number(event.target.value)); draw(); });
  find('show').addEventListener('change', (event) => show(event.target.value));
  find('exposure').addEventListener('input', (event) => expose(Number(event.target.value)));
  controls.addEventListener('change', draw);
  addEventListener('resize', resize);
  look(Number(asked.get('camera') ?? 0));
  resize();
  find('exposure').value = asked.get('exposure') ?? 0;
  expose(Number(find('exposure').value));
  find('show').value = asked.get('show') ?? 'lit';
  show(find('show').value);
  find('panel').hidden = asked.get('panel') === '0';
  say('');
  document.title = `${manifest.scene ?? 'Baked scene'}`;
  document.body.dataset.ready = 'true';
}

start().catch((error) => {
  console.error(error);
  say(`Cannot show the scene: ${error.message}`);
});
