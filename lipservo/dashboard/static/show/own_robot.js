// The user's own robot, a GLB or a URDF, moved by the encoders. The files never leave the browser.

import { GLTFLoader, OrbitControls, THREE } from "nicegui-scene";
import { drawnDeg, face, onDraw, onHello } from "../link.js";
import { spoken } from "../words.js";
import { nodeJoints, urdfModel } from "./joints.js";

const MOST_BYTES = 200e6;
const ASK =
  "A .glb, or a .urdf together with its .stl files. Nodes or joints with the names of servos move.";

class FaceModel extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      `<p class="hint">${ASK}</p><p><label class="act">Open a model ` +
      '<input type="file" accept=".glb,.gltf,.urdf,.stl" multiple hidden></label></p>' +
      '<p class="told" role="status"></p><div class="stage" hidden></div>';
    this.told = this.querySelector(".told");
    this.stage = this.querySelector(".stage");
    this.joints = [];
    this.querySelector("input").addEventListener("change", (event) => this.open([...event.target.files]));
    this.addEventListener("dragover", (event) => event.preventDefault());
    this.addEventListener("drop", (event) => {
      event.preventDefault();
      this.open([...event.dataTransfer.files]);
    });
    this.undo = [onHello(() => this.match()), onDraw((frame) => this.draw(frame))];
    window.ownRobot = this;
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
    this.view?.stop();
  }

  /** Show what lies in some files; says in one line what is wrong with them. */
  async open(files) {
    this.say("Reading the model ...");
    try {
      if (files.reduce((sum, each) => sum + each.size, 0) > MOST_BYTES) {
        throw new Error(`more than ${MOST_BYTES / 1e6} MB; give a smaller model`);
      }
      const model = await readModel(files, face.hello?.servos ?? []);
      this.view?.stop();
      this.stage.hidden = false;
      this.view = makeView(this.stage, model.root);
      this.model = model;
      this.match();
    } catch (error) {
      this.say(`The model cannot be shown: ${error.message}`, "bad");
    }
  }

  /** Say which servos have a joint: also when another face takes the place of this one. */
  match() {
    if (!this.model) return;
    const servos = face.hello?.servos ?? [];
    this.joints = this.model.jointsOf(servos);
    const names = new Set(this.joints.map((each) => each.name));
    const without = servos.filter((name) => !names.has(name));
    if (!this.joints.length) {
      const seen = this.model.names.slice(0, 8).join(", ") || "none";
      this.say(
        `No part of this model is named as a servo. Servos: ${servos.join(", ")}. Parts: ${seen}.`,
        "bad",
      );
    } else {
      const lost = this.model.missing.length ? ` Not found: ${this.model.missing.join(", ")}.` : "";
      const still = without.length ? ` Without a joint: ${without.map(spoken).join(", ")}.` : "";
      const n = this.joints.length;
      this.say(`${n === 1 ? "1 joint moves" : `${n} joints move`}.${still}${lost}`);
    }
    this.view.draw();
  }

  /** Turn the model's joints to the measured angles of a frame, and draw it. */
  draw(frame) {
    if (!this.view || !this.joints.length) return;
    const encoders = drawnDeg(frame);
    this.shown = {};
    face.hello.servos.forEach((name, i) => {
      const joint = this.joints.find((each) => each.name === name);
      if (!joint || encoders[i] === null) return;
      joint.turn(encoders[i]);
      this.shown[name] = encoders[i];
    });
    this.view.draw();
  }

  say(text, tone = "") {
    this.told.textContent = text;
    this.told.dataset.tone = tone;
  }
}

/**
 * {root, names, missing, jointsOf(servos)} of a model: its three.js object, names of its parts, meshes
 * that are not among the files, and its joints with the names of servos. Throws an Error, one line.
 */
export async function readModel(files, servos) {
  const urdf = files.find((each) => /\.urdf$/i.test(each.name));
  if (urdf) {
    const meshes = new Map();
    for (const each of files) meshes.set(each.name.toLowerCase(), await each.arrayBuffer());
    const text = await urdf.text();
    let made = urdfModel(text, meshes, servos);
    const names = [];
    made.root.traverse((node) => node.name && names.push(node.name));
    const root = made.root;
    // Another face has other servos: joints are matched anew, in the tree that is shown.
    const jointsOf = (now) => {
      made = urdfModel(text, meshes, now);
      root.clear();
      root.add(...made.root.children);
      return made.joints;
    };
    return { root, names, missing: made.missing, jointsOf };
  }
  const glb = files.find((each) => /\.(glb|gltf)$/i.test(each.name));
  if (!glb) throw new Error("none of these files is a .glb or a .urdf");
  const buffer = await glb.arrayBuffer();
  const { scene } = await new Promise((resolve, reject) => {
    try {
      new GLTFLoader().parse(buffer, "", resolve, (error) => reject(new Error(error.message ?? "damaged")));
    } catch (error) {
      reject(error);
    }
  });
  const names = [];
  scene.traverse((node) => node.name && names.push(node.name));
  let kept = [];
  const jointsOf = (now) => {
    kept.forEach((each) => each.turn(0)); // angles count from how the model stands in its file
    kept = nodeJoints(scene, now);
    return kept;
  };
  return { root: scene, names, missing: [], jointsOf };
}

/** A stage that looks at a whole model from the front, and draws it when asked. */
function makeView(stage, root) {
  const probe = document.createElement("canvas").getContext("webgl2");
  if (!probe) throw new Error("this browser has no WebGL");
  probe.getExtension("WEBGL_lose_context")?.loseContext();
  const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  stage.append(renderer.domElement);
  const scene = new THREE.Scene();
  renderer.setClearColor(0, 0);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f94, 2.2));
  const lamp = new THREE.DirectionalLight(0xffffff, 1.6);
  lamp.position.set(-1, 1.5, 2);
  scene.add(lamp, root);
  const box = new THREE.Box3().setFromObject(root);
  if (box.isEmpty()) throw new Error("it holds nothing to draw");
  const middle = box.getCenter(new THREE.Vector3());
  const reach = Math.max(box.getSize(new THREE.Vector3()).length(), 1e-6);
  const camera = new THREE.PerspectiveCamera(30, 1, reach / 100, reach * 20);
  camera.position.copy(middle).add(new THREE.Vector3(0, 0, 2 * reach));
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.target.copy(middle);
  controls.update();
  let waiting = null;
  const paint = () => {
    waiting = null;
    renderer.render(scene, camera);
  };
  const draw = () => {
    waiting ??= requestAnimationFrame(paint);
  };
  controls.addEventListener("change", draw);
  const sizes = new ResizeObserver(() => {
    if (!stage.clientWidth) return;
    renderer.setSize(stage.clientWidth, stage.clientHeight);
    camera.aspect = stage.clientWidth / stage.clientHeight;
    camera.updateProjectionMatrix();
    draw();
  });
  sizes.observe(stage);
  return {
    draw,
    stop() {
      cancelAnimationFrame(waiting);
      sizes.disconnect();
      controls.dispose();
      scene.traverse((each) => {
        each.geometry?.dispose();
        for (const one of [each.material ?? []].flat()) {
          one.map?.dispose();
          one.dispose();
        }
      });
      renderer.dispose();
      renderer.domElement.remove();
    },
  };
}

customElements.define("face-model", FaceModel);
