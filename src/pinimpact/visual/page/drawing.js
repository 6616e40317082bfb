"use strict";
// What is drawn beside the robot: arrows, cones, trails, plates, and the hodograph on a flat canvas.

// Okabe and Ito's palette, which colour-blind readers tell apart
const COLORS = {
  impulse: "#d55e00", before: "#56b4e9", after: "#0072b2", force: "#009e73", cone: "#e69f00", path: "#cc79a7",
  surface: "#b08d57", link: "#8a8f98", lit: "#f0e442", grid: "#888888", cloud: "#7a5195",
  compression: "#d55e00", restitution: "#0072b2",
};

const Drawing = (() => {
  const THREE = MeshCat.THREE;
  const UP = new THREE.Vector3(0, 1, 0);

  // seen through the robot, in the order of `layer`
  function glow(color, layer, opacity) {
    const material = new THREE.MeshBasicMaterial({
      color, transparent: true, opacity: opacity === undefined ? 1 : opacity, depthTest: false, depthWrite: false,
      side: THREE.DoubleSide,
    });
    return mesh => { mesh.material = material; mesh.renderOrder = layer; return mesh; };
  }

  // an arrow of a given shaft radius; `set` takes where it starts and the way to its tip
  function arrow(color, radius, layer) {
    const group = new THREE.Group(), wear = glow(color, layer);
    const shaft = wear(new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 1, 12)));
    const tip = wear(new THREE.Mesh(new THREE.CylinderGeometry(0, 2.6 * radius, 1, 16)));
    group.add(shaft, tip);
    group.visible = false;
    group.set = (start, way) => {
      const length = way.length();
      group.visible = length > 0.2 * radius;
      if (!group.visible) return;
      const head = Math.min(0.45 * length, 7 * radius);
      group.position.copy(start);
      group.quaternion.setFromUnitVectors(UP, way.clone().divideScalar(length));
      shaft.scale.y = Math.max(length - head, 1e-9);
      shaft.position.y = 0.5 * (length - head);
      tip.scale.y = head;
      tip.position.y = length - 0.5 * head;
    };
    return group;
  }

  // the friction cone: its apex, its axis, height and radius
  function cone(color) {
    const turned = new THREE.Group();
    const ring = glow(color, 11)(new THREE.Mesh(new THREE.TorusGeometry(1, 0.012, 6, 60)));
    ring.rotation.x = Math.PI / 2;
    ring.position.y = -0.5;
    turned.add(glow(color, 10, 0.22)(new THREE.Mesh(new THREE.ConeGeometry(1, 1, 40, 1, true))), ring);
    turned.rotation.x = Math.PI;
    turned.position.y = 0.5;
    const whole = new THREE.Group();
    whole.add(turned);
    whole.visible = false;
    whole.set = (apex, axis, height, radius) => {
      whole.visible = height > 0 && radius > 0;
      whole.position.copy(apex);
      whole.quaternion.setFromUnitVectors(UP, axis);
      whole.scale.set(radius, height, radius);
    };
    return whole;
  }

  // a bar between two points
  function bar(color, radius) {
    const mesh = new THREE.Mesh(
      new THREE.CylinderGeometry(radius, radius, 1, 10), new THREE.MeshLambertMaterial({ color }));
    mesh.set = (a, b) => {
      const way = b.clone().sub(a), length = way.length();
      mesh.visible = length > 1e-9;
      if (!mesh.visible) return;
      mesh.position.copy(a).addScaledVector(way, 0.5);
      mesh.quaternion.setFromUnitVectors(UP, way.divideScalar(length));
      mesh.scale.y = length;
    };
    return mesh;
  }

  // the path of a point as a thin tube, drawn up to one of its points; the whole of it faintly
  function trail(color, points, radius) {
    const count = points.length / 3, sides = 4;
    const places = new Float32Array(count * sides * 3), index = [];
    const at = i => new THREE.Vector3(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
    let along = new THREE.Vector3(0, 0, 1), p = at(0);
    for (let i = 0; i < count; i++) {
      const next = at(Math.min(i + 1, count - 1)), way = next.clone().sub(p);
      if (way.length() > 1e-9) along = way.normalize();
      const side = Math.abs(along.z) < 0.9 ? new THREE.Vector3(0, 0, 1) : new THREE.Vector3(1, 0, 0);
      const u = side.cross(along).normalize(), w = along.clone().cross(u);
      for (let k = 0; k < sides; k++) {
        const angle = 2 * Math.PI * k / sides;
        const q = p.clone().addScaledVector(u, radius * Math.cos(angle)).addScaledVector(w, radius * Math.sin(angle));
        places.set([q.x, q.y, q.z], 3 * (i * sides + k));
        if (i > 0) {
          const a = (i - 1) * sides + k, b = (i - 1) * sides + (k + 1) % sides;
          index.push(a, b, a + sides, b, b + sides, a + sides);
        }
      }
      p = next;
    }
    const shape = () => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
      geometry.setIndex(index);
      return geometry;
    };
    const group = new THREE.Group(), done = glow(color, 5)(new THREE.Mesh(shape()));
    group.add(glow(color, 4, 0.25)(new THREE.Mesh(shape())), done);
    done.frustumCulled = false;
    group.show = upTo => done.geometry.setDrawRange(0, Math.max(0, upTo) * sides * 6);
    return group;
  }

  // a plate or a ball; material that moves is checked, and `move` takes the checks to a time
  function surface(what) {
    const look = { color: COLORS.surface, opacity: 0.75, transparent: true };
    const plain = new THREE.MeshLambertMaterial(look);
    const [a, b, c] = what.size, ball = what.kind === "sphere";
    const shape = ball ? new THREE.SphereGeometry(a, 40, 24) : new THREE.BoxGeometry(a, b, c);
    const mesh = new THREE.Mesh(shape, plain), start = new THREE.Matrix4().fromArray(what.matrix);
    mesh.matrixAutoUpdate = false;
    mesh.matrix.copy(start);
    if (!moves(what)) return mesh;
    const checks = checked(), spin = new THREE.Vector3(...what.spin), rate = spin.length();
    const worn = new THREE.MeshLambertMaterial({ ...look, map: checks });
    if (ball) {
      mesh.material = worn;
      checks.repeat.set(8, 4);
      const axis = spin.normalize(), turn = new THREE.Matrix4();
      mesh.move = t => mesh.matrix.multiplyMatrices(start, turn.makeRotationAxis(axis, rate * t));
      return mesh;
    }
    mesh.material = [plain, plain, plain, plain, worn, plain];  // the fifth side is the upper one
    checks.matrixAutoUpdate = false;
    const [v1, v2] = what.slide, w = what.spin[2], period = Math.max(a, b) / 6;
    mesh.move = t => {
      // where the material at (x, y) was at t = 0: turned back about the point that stands still, or shifted back
      const cos = Math.cos(w * t), sin = Math.sin(w * t), [x, y] = w ? [-v2 / w, v1 / w] : [0, 0];
      const back = w ? [x - cos * x - sin * y, y + sin * x - cos * y] : [-v1 * t, -v2 * t];
      checks.matrix.set(
        cos * a / period, sin * b / period, (back[0] - 0.5 * (cos * a + sin * b)) / period,
        -sin * a / period, cos * b / period, (back[1] + 0.5 * (sin * a - cos * b)) / period, 0, 0, 1);
    };
    mesh.move(0);
    return mesh;
  }

  // whether one can see a surface's material move: a plate within its plane, a ball about its centre
  function moves(what) {
    const flat = what.kind === "sphere" ? what.spin : [what.slide[0], what.slide[1], what.spin[2]];
    return flat.some(x => x !== 0);
  }

  function checked() {
    const picture = document.createElement("canvas"), g = picture.getContext("2d");
    picture.width = picture.height = 64;
    g.fillStyle = "#ffffff";
    g.fillRect(0, 0, 64, 64);
    g.fillStyle = "#8f8f8f";
    g.fillRect(0, 0, 32, 32);
    g.fillRect(32, 32, 32, 32);
    const texture = new THREE.CanvasTexture(picture);
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    return texture;
  }

  // a collision shape, shown while it touches; it shines through what stands before it
  function lit(what, corners) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    const mesh = glow(COLORS.lit, 3, 0.45)(new THREE.Mesh(geometry));
    mesh.matrixAutoUpdate = false;
    mesh.matrix.fromArray(what.matrix);
    mesh.visible = false;
    return mesh;
  }

  // a translucent copy of what is drawn at a joint
  function ghost(object, opacity) {
    const copy = object.clone(true);
    copy.traverse(part => {
      if (!part.isMesh) return;
      part.material = new THREE.MeshLambertMaterial({
        color: COLORS.cloud, transparent: true, opacity, depthWrite: false, side: THREE.DoubleSide,
      });
    });
    return copy;
  }

  // --- flat pictures of one contact's impact -------------------------------------------------------------

  // where path[share] lies, linearly between its points
  function along(mark, share, row) {
    const clock = mark.clock;
    let i = 1;
    while (i < clock.length - 1 && clock[i] < share) i++;
    const width = clock[i] - clock[i - 1];
    const part = width > 0 ? Math.min(1, Math.max(0, (share - clock[i - 1]) / width)) : 1;
    return mark[row][i].map((x, k) => (1 - part) * mark[row][i - 1][k] + part * x);
  }

  function label(g, text, x, y, align, color, widest) {
    g.fillStyle = color || "#111";
    g.textAlign = align || "left";
    g.fillText(text, x, y, widest);
  }

  function line(g, points, color, width, dash) {
    g.strokeStyle = color;
    g.lineWidth = width;
    g.setLineDash(dash || []);
    g.beginPath();
    points.forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y));
    g.stroke();
    g.setLineDash([]);
  }

  function dot(g, x, y, radius, fill, edge) {
    g.beginPath();
    g.arc(x, y, radius, 0, 2 * Math.PI);
    g.fillStyle = fill;
    g.fill();
    g.lineWidth = edge ? 2 : 1.2;
    g.strokeStyle = edge || "#111";
    g.stroke();
  }

  const TITLES = 48;  // height of what is written above and below a hodograph [px]

  // the sliding velocity in the tangential plane: flow of slip, invariant directions, path up to `share`
  function hodograph(g, x0, size, mark, share, name) {
    const [w11, w12, w13, , w22, w23] = mark.delassus, mu = mark.mu, y0 = TITLES - 16;
    const reach = 1.15 * Math.max(1e-12, ...mark.velocity.map(v => Math.max(Math.abs(v[0]), Math.abs(v[1]))));
    const middle = [x0 + size / 2, y0 + size / 2], scale = size / 2 / reach;
    const to = v => [middle[0] + scale * v[0], middle[1] - scale * v[1]];
    const rate = v => {
      const speed = Math.hypot(v[0], v[1]) || 1, s = [v[0] / speed, v[1] / speed];
      return [w13 - mu * (w11 * s[0] + w12 * s[1]), w23 - mu * (w12 * s[0] + w22 * s[1])];
    };
    g.save();
    g.beginPath();
    g.rect(x0, y0, size, size);
    g.clip();
    const cells = 11, step = 2 * reach / cells;
    for (let i = 0; i < cells; i++) for (let j = 0; j < cells; j++) {
      const v = [-reach + (i + 0.5) * step, -reach + (j + 0.5) * step], r = rate(v), norm = Math.hypot(r[0], r[1]);
      if (!norm || Math.hypot(v[0], v[1]) < 0.3 * step) continue;
      const way = r.map(x => 0.36 * step * x / norm);
      const a = to([v[0] - way[0], v[1] - way[1]]), b = to([v[0] + way[0], v[1] + way[1]]);
      line(g, [a, b], "#b8bec5", 1);
      const turn = Math.atan2(b[1] - a[1], b[0] - a[0]);
      line(g, [-0.5, 0.5].map(d => [b[0] - 4 * Math.cos(turn + d), b[1] - 4 * Math.sin(turn + d)])
        .flatMap(p => [p, b]), "#b8bec5", 1);
    }
    line(g, [to([-reach, 0]), to([reach, 0])], "#888", 0.6);
    line(g, [to([0, -reach]), to([0, reach])], "#888", 0.6);
    const kinds = new Set();
    for (const angle of mark.invariant) {
      const c = Math.cos(angle), s = Math.sin(angle), along = rate([c, s]);
      const across = mu * (w11 * s * s - 2 * w12 * s * c + w22 * c * c);
      const repels = c * along[0] + s * along[1] + across < 0;
      kinds.add(repels ? "dashed: repelling" : "solid: attracting");
      line(g, [to([0, 0]), to([1.5 * reach * c, 1.5 * reach * s])], "#333", 1.2, repels ? [5, 4] : []);
    }
    line(g, mark.velocity.map(to), "#999", 1);
    const p3 = i => mark.impulse[i][2], now = along(mark, share, "velocity");
    const compressed = Math.max(0, ...mark.segments.filter(s => s[1] === "compression").map(s => s[3]));
    const last = mark.velocity.reduce((found, _, i) => p3(i) <= compressed * (1 + 1e-9) ? i : found, 0);
    const done = mark.velocity.map((v, i) => [v, i]).filter(([, i]) => mark.clock[i] <= share).concat([[now, Infinity]]);
    const phases = [["compression", done.filter(([, i]) => i <= last)], ["restitution", done.filter(([, i]) => i >= last)]];
    if (done[done.length - 2][1] < last) phases[0][1].push([now, 0]);
    for (const [phase, points] of phases) if (points.length > 1) line(g, points.map(([v]) => to(v)), COLORS[phase], 2.4);
    dot(g, ...to(mark.velocity[0]), 4, "white", COLORS.compression);
    dot(g, ...to(now), 5, done[done.length - 2][1] < last ? COLORS.compression : COLORS.restitution);
    g.restore();
    line(g, [[x0, y0], [x0 + size, y0], [x0 + size, y0 + size], [x0, y0 + size], [x0, y0]], "#888", 1);
    g.font = "12px system-ui, sans-serif";
    label(g, name, x0, 12, "left", "#111", size);
    label(g, `Sliding velocity, ± ${reach.toPrecision(2)} m/s`, x0, name ? 27 : 20, "left", "#111", size);
    if (kinds.size) label(g, [...kinds].sort().reverse().join(", "), x0, y0 + size + 12, "left", "#111", size);
    label(g, "v₁", x0 + size - 18, middle[1] - 5);
    label(g, "v₂", middle[0] + 5, y0 + 14);
  }

  // contact velocity over the normal impulse, with a cursor at `share`
  function history(g, x0, y0, width, height, mark, share) {
    const all = mark.velocity.flat(), low = Math.min(0, ...all), high = Math.max(0, ...all);
    const last = mark.impulse[mark.impulse.length - 1][2] || 1, span = high - low || 1;
    const to = (p, v) => [x0 + width * p / last, y0 + height * (1 - 0.05 - 0.9 * (v - low) / span)];
    for (const [mode, , start, end] of mark.segments) if (mode === "stick") {
      g.fillStyle = "rgba(230, 159, 0, 0.25)";
      g.fillRect(to(start, 0)[0], y0, to(end, 0)[0] - to(start, 0)[0], height);
    }
    line(g, [to(0, 0), to(last, 0)], "#888", 0.6);
    g.font = "12px system-ui, sans-serif";
    const rows = [["v₁", "#009e73", []], ["v₂", "#cc79a7", [7, 3]], ["v₃", "#111", []]];
    const ends = rows.map(([name, color, dash], row) => {
      line(g, mark.velocity.map((v, i) => to(mark.impulse[i][2], v[row])), color, 1.8, dash);
      return [name, color, to(last, mark.velocity[mark.velocity.length - 1][row])[1] + 4];
    });
    let below = -Infinity;
    for (const [name, color, y] of ends.sort((a, b) => a[2] - b[2])) {
      below = Math.max(y, below + 13);
      label(g, name, x0 + width + 4, below, "left", color);
    }
    const compressed = mark.segments.filter(s => s[1] === "compression").map(s => s[3]);
    if (compressed.length) {
      const end = to(Math.max(...compressed), 0)[0];
      line(g, [[end, y0], [end, y0 + height]], COLORS.compression, 1, [7, 3, 2, 3]);
    }
    const now = along(mark, share, "impulse")[2];
    line(g, [[to(now, 0)[0], y0], [to(now, 0)[0], y0 + height]], COLORS.after, 1.4);
    line(g, [[x0, y0], [x0 + width, y0], [x0 + width, y0 + height], [x0, y0 + height], [x0, y0]], "#888", 1);
    label(g, `normal impulse P₃ to ${last.toPrecision(3)} N s`, x0, y0 + height + 15);
    label(g, `velocity, ${low.toPrecision(2)} to ${high.toPrecision(2)} m/s`, x0, y0 - 5);
  }

  return { arrow, cone, bar, trail, surface, moves, lit, ghost, along, hodograph, history, TITLES };
})();
