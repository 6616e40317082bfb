"use strict";
// Plays a motion: film time runs evenly, the motion's own time slows down at impacts and stands still within them.

(async () => {
  const root = document.documentElement, find = id => document.getElementById(id);
  const errors = [];
  const fail = text => {
    errors.push(text);
    root.dataset.errors = JSON.stringify(errors);
    find("failure").style.display = "block";
    find("failure").textContent = text;
  };
  root.dataset.errors = "[]";
  window.addEventListener("error", event => fail(String(event.message)));
  window.addEventListener("unhandledrejection", event => fail(String(event.reason)));

  // #t=0.25 stands at a time of the motion, #impact=2 at an impact, #film=1.5 at a time of the film; a program
  // that wants all frames of the film says how many a second, and how large, and of which kind: #frames=25,960,540,jpeg
  const [place, value, wide, tall, kind] = location.hash.slice(1).split(/[=,]/);
  const room = { get wide() { return Number(wide) || innerWidth; }, get tall() { return Number(tall) || innerHeight; } };
  const data = JSON.parse(find("motion").textContent);
  const LEAST = 90;  // side of a hodograph that can be read [px]
  const GAP = 8, BAR = 56;  // between panels, and the height of the bar with its gaps [px]
  const upright = () => room.wide < room.tall;
  const sideWidth = () => upright() ? room.wide - 2 * GAP : Math.min(300, Math.max(215, 0.27 * room.wide));
  function fit() {
    document.body.style.width = `${room.wide}px`;
    document.body.style.height = `${room.tall}px`;
    document.body.style.fontSize = `${Math.min(14, Math.max(11, room.tall / 46))}px`;
    document.body.className = data.within ? "within" : "";
    find("side").style.width = `${sideWidth()}px`;
  }
  fit();

  const THREE = MeshCat.THREE;
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const numbers = (text, kind) => new kind(bytes(text).buffer);

  async function unpacked(text) {
    const inflate = new DecompressionStream("gzip"), writer = inflate.writable.getWriter(), parts = [];
    const written = writer.write(bytes(text)).then(() => writer.close());
    const reader = inflate.readable.getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) parts.push(part.value);
    await written;
    const whole = new Uint8Array(parts.reduce((length, part) => length + part.length, 0));
    let start = 0;
    for (const part of parts) {
      whole.set(part, start);
      start += part.length;
    }
    return whole;
  }

  // --- the scene -------------------------------------------------------------------------------------------

  let viewer;
  try {
    viewer = new MeshCat.Viewer(find("view"));
  } catch (error) {
    fail(`This browser shows no 3D pictures (WebGL): ${error.message}`);
    throw error;
  }
  viewer.gui.domElement.style.display = "none";
  const kept = [], handle = viewer.handle_command.bind(viewer);
  const whole = value => {
    if (value === null || typeof value !== "object" || ArrayBuffer.isView(value)) return value;
    if ("kept" in value) return kept[value.kept];
    for (const name of Object.keys(value)) value[name] = whole(value[name]);
    return value;
  };
  viewer.handle_command = command => command.type === "keep" ? kept.push(command.value) : handle(whole(command));
  const shapes = await unpacked(find("shapes").textContent), lengths = new DataView(shapes.buffer);
  for (let at = 0; at < shapes.length;) {
    const length = lengths.getUint32(at, true);
    viewer.handle_command_bytearray(shapes.subarray(at + 4, at + 4 + length));
    at += 4 + length;
  }

  // files of meshes may leave the normals at zero, which shows black
  viewer.scene.traverse(({ geometry }) => {
    const normal = geometry && geometry.attributes && geometry.attributes.normal;
    if (normal && !normal.array.some(x => x !== 0)) geometry.computeVertexNormals();
  });

  const times = numbers(data.times, Float64Array), frames = times.length;
  const joint = number => viewer.scene_tree.find(["meshcat", "robot", String(number)]).object;
  const moving = Object.entries(data.joints).map(([number, poses]) => {
    return { object: joint(number), poses: numbers(poses, Float32Array) };
  });
  for (const [number, pose] of Object.entries(data.still)) {
    joint(number).position.fromArray(pose);
    joint(number).quaternion.fromArray(pose, 3);
  }
  const extra = new THREE.Group();
  viewer.scene.add(extra);
  const radius = data.view.thickness, put = object => { extra.add(object); return object; };
  const links = data.links.map(([a, b]) => [joint(a), joint(b), put(Drawing.bar(COLORS.link, 1.6 * radius))]);
  for (const [number, ...end] of data.spots) {
    const spot = Drawing.bar(COLORS.link, radius);
    spot.set(new THREE.Vector3(), new THREE.Vector3(...end));
    joint(number).add(spot);
  }
  // other motions: translucent copies of the robot, and the paths of their first joint
  const cloud = !data.cloud ? [] : data.cloud.robots.map(tracks => Object.entries(tracks).map(([number, poses], i) => {
    const object = Drawing.ghost(joint(number), Math.min(0.3, 1.5 / data.cloud.robots.length)), points = numbers(poses, Float32Array);
    joint(number).parent.add(object);
    const places = new Float32Array(points.length / 7 * 3).map((_, k) => points[7 * Math.floor(k / 3) + k % 3]);
    const trail = i ? null : put(Drawing.trail(COLORS.cloud, places, 0.2 * radius));
    return { object, poses: points, trail };
  })).flat();
  const cloudTimes = data.cloud && numbers(data.cloud.times, Float64Array);
  const surfaces = data.surfaces.map(what => {
    const drawn = Drawing.surface(what);
    joint(what.joint).add(drawn);
    return drawn;
  });
  const lit = data.lit.map(what => {
    const shape = Drawing.lit(what, numbers(what.triangles, Float32Array));
    joint(what.joint).add(shape);
    return { shape, times: what.times };
  });
  const contacts = data.contacts.map(({ name, path, forces }) => ({
    name, path: numbers(path, Float32Array), forces: forces && numbers(forces, Float32Array),
  }));
  const trails = contacts.map(contact => put(Drawing.trail(COLORS.path, contact.path, 0.5 * radius)));
  const forceArrows = contacts.map(contact => contact.forces && put(Drawing.arrow(COLORS.force, radius, 20)));
  const most = Math.max(0, ...data.impacts.map(impact => impact.contacts.length));
  const marks = Array.from({ length: most }, () => ({
    cone: put(Drawing.cone(COLORS.cone)),
    before: put(Drawing.arrow(COLORS.before, 0.8 * radius, 21)),
    after: put(Drawing.arrow(COLORS.after, 0.8 * radius, 22)),
    impulse: put(Drawing.arrow(COLORS.impulse, radius, 23)),
  }));

  // the part of the window without panels: its centre and its size [px]
  function free() {
    const left = upright() ? 0 : sideWidth() + GAP, right = room.wide - (data.within ? panelWidth() + GAP : 0);
    const top = upright() ? 0.4 * room.tall : 0, bottom = room.tall - BAR;
    return { x: 0.5 * (left + right), y: 0.5 * (top + bottom), wide: Math.max(right - left, 50), tall: bottom - top };
  }

  // the nearest camera, of a given direction, that has all of what moves in the free part of the window
  const { size } = data.view, outline = numbers(data.view.points, Float32Array);
  function look() {
    const { wide, tall } = free(), back = new THREE.Vector3(0.72, 0.34, 0.6).normalize();
    const right = new THREE.Vector3(0, 1, 0).cross(back).normalize(), up = back.clone().cross(right);
    const slope = Math.tan(Math.PI / 8), point = new THREE.Vector3(), middle = new THREE.Vector3();
    let away = 0;
    for (const [axis, part] of [[right, wide], [up, tall]]) {
      const half = 0.92 * slope * part / room.tall;
      let low = Infinity, high = -Infinity;
      for (let i = 0; i < outline.length; i += 3) {
        point.set(outline[i], outline[i + 2], -outline[i + 1]);
        low = Math.min(low, point.dot(axis) - half * point.dot(back));
        high = Math.max(high, point.dot(axis) + half * point.dot(back));
      }
      away = Math.max(away, 0.5 * (high - low) / half);
      middle.addScaledVector(axis, 0.5 * (high + low));
    }
    let depth = 0;
    for (let i = 0; i < outline.length; i += 3)
      depth += point.set(outline[i], outline[i + 2], -outline[i + 1]).dot(back) / (outline.length / 3);
    viewer.camera.fov = 45;
    viewer.camera.near = 0.005 * size;
    viewer.camera.far = 100 * size;
    viewer.controls.target.copy(middle).addScaledVector(back, depth);  // what the mouse turns it about
    viewer.camera.position.copy(middle).addScaledVector(back, Math.max(away, depth + 0.1 * size));
    viewer.controls.update();
  }

  // what is seen stands in the middle of the free part of the window
  function resize() {
    fit();
    viewer.set_3d_pane_size(room.wide, room.tall);
    const { x, y } = free();
    viewer.camera.setViewOffset(
      room.wide, room.tall, 0.5 * room.wide - x, 0.5 * room.tall - y, room.wide, room.tall);
    if (!turned) look();
  }
  let turned = false;  // by the user
  viewer.controls.addEventListener("start", () => { turned = true; });
  resize();

  // --- film time ---------------------------------------------------------------------------------------------

  const settings = { speed: data.speed, slowdown: data.slowdown, hold: data.hold };
  const slow = data.impacts.filter(impact => impact.slow);
  let pieces = [], duration = 0;

  function slower(t) {
    let most = 1;
    for (const impact of slow) {
      const x = (t - impact.time) / data.width;
      if (Math.abs(x) < 5) most = Math.max(most, 1 + (settings.slowdown - 1) * Math.exp(-x * x));
    }
    return most;
  }

  // each piece of film is a stretch between two frames, or the standstill in an impact
  function cut() {
    pieces = [];
    let film = 0, waiting = 0;
    const hold = settings.slowdown > 1 ? settings.hold : 0;
    const stand = frame => {
      for (; waiting < slow.length && slow[waiting].time <= times[frame]; waiting++)
        if (hold > 0) {
          pieces.push({ film, length: hold, frame, impact: slow[waiting] });
          film += hold;
        }
    };
    for (let frame = 0; frame < frames; frame++) {
      const width = frame + 1 < frames ? times[frame + 1] - times[frame] : 0;
      if (!(width === 0 && frame + 1 < frames)) stand(frame);  // at an impact the second of its frames
      if (width > 0) {
        const length = width * slower(times[frame] + 0.5 * width) / settings.speed;
        pieces.push({ film, length, frame, impact: null });
        film += length;
      }
    }
    if (!pieces.length) pieces.push({ film: 0, length: 0, frame: 0, impact: null });
    duration = film;
    find("film").max = Math.max(duration, 1e-9);
    root.dataset.duration = duration;
    for (const old of find("track").querySelectorAll("b")) old.remove();
    if (!data.within) data.impacts.forEach((impact, i) => {
      if (!impact.slow && data.impacts.length > 200) return;
      const tick = document.createElement("b");
      tick.style.left = `${duration > 0 ? 100 * filmOf(impact.time) / duration : 0}%`;
      tick.title = `impact ${i + 1}: ${impact.source}`;
      tick.onclick = () => toImpact(i);
      find("track").appendChild(tick);
    });
  }

  function pieceAt(film) {
    let low = 0, high = pieces.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (pieces[middle].film <= film) low = middle; else high = middle - 1;
    }
    return pieces[low];
  }

  // when in the film a time of the motion comes; at an impact when it begins
  function filmOf(t) {
    for (const piece of pieces) {
      if (piece.impact) {
        if (times[piece.frame] >= t) return piece.film;
        continue;
      }
      const a = times[piece.frame], b = times[piece.frame + 1];
      if (t <= b) return piece.film + piece.length * Math.max(0, t - a) / (b - a);
    }
    return duration;
  }

  // --- one picture -------------------------------------------------------------------------------------------

  const a = new THREE.Vector3(), b = new THREE.Vector3(), p = new THREE.Quaternion(), q = new THREE.Quaternion();
  const world = (axes, v) => new THREE.Vector3(
    axes[0] * v[0] + axes[3] * v[1] + axes[6] * v[2],
    axes[1] * v[0] + axes[4] * v[1] + axes[7] * v[2],
    axes[2] * v[0] + axes[5] * v[1] + axes[8] * v[2]);
  const pose = (object, poses, from, to, part) => {
    object.position.copy(a.fromArray(poses, 7 * from)).lerp(b.fromArray(poses, 7 * to), part);
    object.quaternion.copy(p.fromArray(poses, 7 * from + 3)).slerp(q.fromArray(poses, 7 * to + 3), part);
  };
  let film = 0, playing = false;

  function moveCloud(t) {
    const last = cloudTimes.length - 1, at = last * (t - cloudTimes[0]) / (cloudTimes[last] - cloudTimes[0]);
    const frame = Math.min(Math.max(Math.floor(at), 0), last - 1), part = Math.min(Math.max(at - frame, 0), 1);
    for (const { object, poses, trail } of cloud) {
      pose(object, poses, frame, frame + 1, part);
      if (trail) trail.show(frame + (part > 0 ? 1 : 0));
    }
  }

  function show(time) {
    film = Math.min(Math.max(time, 0), duration);
    const piece = pieceAt(film), next = Math.min(piece.frame + 1, frames - 1);
    const share = piece.length > 0 ? Math.min(1, (film - piece.film) / piece.length) : 1;
    const part = piece.impact ? 0 : share;
    const t = (1 - part) * times[piece.frame] + part * times[next];
    for (const { object, poses } of moving) pose(object, poses, piece.frame, next, part);
    if (cloud.length) moveCloud(t);
    for (const drawn of surfaces) if (drawn.move) drawn.move(t);
    for (const [from, to, bar] of links) bar.set(from.position, to.position);
    contacts.forEach((contact, i) => {
      trails[i].show(piece.frame + (part > 0 ? 1 : 0));
      if (!contact.forces) return;
      b.fromArray(contact.forces, 3 * next);
      const force = new THREE.Vector3().fromArray(contact.forces, 3 * piece.frame).lerp(b, part);
      b.fromArray(contact.path, 3 * next);
      const point = new THREE.Vector3().fromArray(contact.path, 3 * piece.frame).lerp(b, part);
      forceArrows[i].set(point, force.multiplyScalar(data.scales.force));
    });
    const impact = piece.impact || nearest(t);
    const struck = impact && impact.time <= t ? impact.time : t;
    for (const { shape, times } of lit)
      shape.visible = times.some(([start, end]) => start <= t && t <= end || start <= struck && struck <= end);
    drawImpact(impact, piece.impact ? share : impact && impact.time <= t ? 1 : 0);
    write(t, piece, share);
    find("film").value = film;
    root.dataset.time = t;
    viewer.set_dirty();
  }

  // the impact that is shown at a time: the last one, for a while, or one that is about to happen
  function nearest(t) {
    let found = null;
    for (const impact of data.impacts) {
      const after = t - impact.time, shown = impact.slow ? 2.5 * data.width : 0.5 * data.width;
      if (after >= 0 && after < shown && (impact.slow || !found || !found.slow)) found = impact;
      if (after < 0 && -after < 1.5 * data.width && !found && impact.slow) found = impact;
    }
    return found;
  }

  function drawImpact(impact, share) {
    const shown = impact ? impact.contacts : [];
    marks.forEach((drawn, i) => {
      const mark = shown[i];
      for (const part of Object.values(drawn)) part.visible = false;
      if (!mark) return;
      const point = new THREE.Vector3(...mark.point), { velocity, impulse } = data.scales;
      const normal = world(mark.axes, [0, 0, 1]);
      const before = world(mark.axes, mark.velocity[0]).multiplyScalar(velocity);
      drawn.before.set(point.clone().sub(before), before);
      if (share <= 0) return;
      const whole = mark.impulse[mark.impulse.length - 1];
      const height = Math.min(impulse * whole[2], 0.3 * size / Math.max(mark.mu, 0.3));
      drawn.cone.set(point, normal, height, mark.mu * height);
      drawn.impulse.set(point, world(mark.axes, Drawing.along(mark, share, "impulse")).multiplyScalar(impulse));
      drawn.after.set(point, world(mark.axes, Drawing.along(mark, share, "velocity")).multiplyScalar(velocity));
    });
    const height = mark => mark.impulse[mark.impulse.length - 1][2];
    const drawn = data.within || settings.slowdown > 1 ? shown : [];  // time enough to read a hodograph
    drawPanel(drawn.filter(mark => mark.segments.length).sort((a, b) => height(b) - height(a))[0], share, shown.length > 1);
  }

  function panelWidth() {
    return Math.round(data.within
      ? Math.min(380, 0.4 * room.wide, 0.55 * room.tall) : Math.min(sideWidth(), 0.31 * room.tall));
  }

  const canvas = find("hodograph");
  function drawPanel(mark, share, named) {
    canvas.hidden = true;
    // beside the words, which come first: what they leave of the side's height
    const left = room.tall - BAR - 3 * GAP - find("overlay").scrollHeight - find("legend").scrollHeight - Drawing.TITLES;
    const wide = data.within ? panelWidth() : Math.min(panelWidth(), left);
    if (!mark || wide < LEAST) return;
    canvas.hidden = false;
    const square = wide + Drawing.TITLES, tall = data.within ? Math.min(square + 200, room.tall - 70) : square;
    const dense = window.devicePixelRatio || 1;
    canvas.width = wide * dense;
    canvas.height = tall * dense;
    canvas.style.width = `${wide}px`;
    canvas.style.height = `${tall}px`;
    const g = canvas.getContext("2d");
    g.setTransform(dense, 0, 0, dense, 0, 0);
    Drawing.hodograph(g, 8, wide - 16, mark, share, named ? mark.name : "");
    if (data.within) Drawing.history(g, 8, square + 20, wide - 40, tall - square - 42, mark, share);
  }

  // --- words -------------------------------------------------------------------------------------------------

  const MANY = 8;
  const digits = x => x !== 0 && Math.abs(x) < 1e-3 ? x.toExponential(2) : String(Number(x.toPrecision(3)));
  const energy = lost => lost >= 0 ? `energy lost ${digits(lost)} J` : `energy gained ${digits(-lost)} J`;

  // what is in which mode; where that would be many rows, one row a mode
  function inWords(now) {
    const points = new Map();
    for (const [source, mode] of now) points.set(`${source}: ${mode}`, (points.get(`${source}: ${mode}`) || 0) + 1);
    if (points.size <= MANY)
      return [...points].map(([text, count]) => count > 1 ? `${text} (${count} points)` : text);
    const byMode = new Map();
    for (const [source, mode] of now) byMode.set(mode, [...new Set([...(byMode.get(mode) || []), source])]);
    return [...byMode].map(([mode, names]) =>
      `${mode}: ${names.slice(0, 3).join(", ")}${names.length > 3 ? ` and ${names.length - 3} more` : ""}`);
  }

  const given = x => x === null ? "of each contact" : `= ${digits(x)}`;

  function write(t, piece, share) {
    const lines = [data.within ? "" : `t = ${t.toFixed(4)} s`];
    if (data.coarse) lines.push("fewer frames than the rotation needs: bodies may turn the wrong way");
    if (piece.impact) {
      for (const mark of piece.impact.contacts) {
        const whole = mark.impulse[mark.impulse.length - 1][2], now = Drawing.along(mark, share, "impulse")[2];
        const segment = mark.segments.find(([, , start, end]) => now >= start && now <= end);
        const what = segment ? `${segment[0]} in ${segment[1]}` : "no impulse";
        lines.push(`${mark.name}: ${what}`, `P₃ = ${now.toFixed(3)} of ${whole.toFixed(3)} N s`);
      }
    } else {
      const now = data.modes.filter(([, , start, end]) => start <= t && (t < end || t === end && end === times[frames - 1]));
      lines.push(...(now.length ? inWords(now) : data.within ? [] : ["free"]));
    }
    const past = data.impacts.filter(impact => impact.time <= t);
    const last = piece.impact || past[past.length - 1];
    if (last) {
      const number = data.impacts.indexOf(last) + 1;
      if (!data.within) lines.push(piece.impact ? `impact ${number} of ${data.impacts.length}`
        : `impact ${number} of ${data.impacts.length}, ${last.time.toFixed(4)} s: ${last.source}`);
      const law = last.law === "energetic" ? "energetic law" : `${last.law[0].toUpperCase()}${last.law.slice(1)}'s law`;
      lines.push(`${law}, e ${given(last.e)}, μ ${given(last.mu)}`, energy(last.lost));
    }
    const overlay = find("overlay");
    overlay.textContent = "";
    lines.filter(text => text).forEach((text, i) => {
      const row = overlay.appendChild(document.createElement("div"));
      row.textContent = text;
      if (i === 0) row.className = "time";
    });
  }

  function legend() {
    const held = data.impacts.some(impact => impact.contacts.length), { longest } = data.scales;
    const rows = [];
    if (held) rows.push(
      ["impulse", `impulse (max. ${digits(longest.impulse)}\u00a0N\u00a0s)`],
      ["cone", "friction cone"],
      ["before", `velocity before (max. ${digits(longest.velocity)}\u00a0m/s)`],
      ["after", "velocity after"]);
    if (contacts.some(contact => contact.forces))
      rows.push(["force", `contact force (max. ${digits(longest.force)}\u00a0N)`]);
    if (contacts.length && !data.within) rows.push(["path", "path of the contact point"]);
    if (cloud.length) rows.push(["cloud", `${data.cloud.robots.length} other samples`]);
    if (data.surfaces.length)
      rows.push(["surface", data.surfaces.some(Drawing.moves) ? "surface; the checks move with it" : "surface"]);
    if (lit.length) rows.push(["lit", "shape in contact"]);
    if (data.view.grid) rows.push(["grid", `grid of ${digits(data.view.grid)} m`]);
    for (const [name, text] of rows) {
      const row = find("legend").appendChild(document.createElement("div"));
      const swatch = row.appendChild(document.createElement("i"));
      swatch.style.background = COLORS[name];
      if (["cone", "surface", "lit"].includes(name)) swatch.className = "wide";
      row.append(text);
    }
    find("legend").hidden = !rows.length;
  }

  // --- controls ----------------------------------------------------------------------------------------------

  function toImpact(number) {
    play(false);
    const impact = data.impacts[number], piece = pieces.find(piece => piece.impact === impact);
    show(piece ? piece.film + 0.999 * piece.length : filmOf(impact.time));
  }

  function step(direction) {
    const starts = data.impacts.map(impact => {
      const piece = pieces.find(piece => piece.impact === impact);
      return piece ? piece.film + 0.999 * piece.length : filmOf(impact.time);
    });
    const edge = 1e-6 * duration;
    const number = direction > 0
      ? starts.findIndex(start => start > film + edge)
      : starts.reduce((found, start, i) => start < film - edge ? i : found, -1);
    if (number >= 0) toImpact(number);
  }

  let clock = null, rest = 0;
  function play(on) {
    playing = on;
    clock = null;
    rest = 0;
    find("play").textContent = on ? "pause" : "play";
  }

  function tick(now) {
    requestAnimationFrame(tick);
    if (!playing || recorder) { clock = null; return; }
    if (clock !== null) {
      const passed = Math.min(0.1, (now - clock) / 1000);
      if (film < duration) show(film + passed);
      else if ((rest += passed) > 1) { rest = 0; show(0); }
    }
    clock = now;
  }

  function options(id, values, chosen, change) {
    for (const value of [...new Set([...values, chosen])].sort((x, y) => x - y)) {
      const option = find(id).appendChild(document.createElement("option"));
      option.value = value;
      option.textContent = `${value} ×`;
      option.selected = value === chosen;
    }
    find(id).onchange = event => {
      const t = Number(root.dataset.time);
      change(Number(event.target.value));
      cut();
      show(filmOf(t));
    };
  }

  // the words of a text in rows of at most this width, the first of which begins at `start`
  function wrapped(g, text, width, start) {
    const rows = [""];
    for (const word of text.split(" ")) {
      const longer = rows[rows.length - 1] + (rows[rows.length - 1] && " ") + word;
      if (g.measureText(longer).width > width - (rows.length > 1 ? 0 : start)) rows.push(word);
      else rows[rows.length - 1] = longer;
    }
    return rows.filter(row => row);
  }

  // the page as one flat picture: the view, the hodograph, the words
  function compose(target) {
    viewer.render();
    const view = viewer.renderer.domElement, g = target.getContext("2d");
    const scale = target.width / room.wide;
    g.setTransform(scale, 0, 0, scale, 0, 0);
    g.fillStyle = "white";
    g.fillRect(0, 0, room.wide, room.tall);
    g.drawImage(view, 0, 0, room.wide, room.tall);
    const panel = (element, draw) => {
      if (element.hidden) return;
      const box = element.getBoundingClientRect();
      g.fillStyle = "rgba(255, 255, 255, 0.82)";
      g.fillRect(box.left, box.top, box.width, box.height);
      draw(box);
    };
    panel(canvas, box => g.drawImage(canvas, box.left, box.top, box.width, box.height));
    for (const id of ["overlay", "legend"]) panel(find(id), () => {
      for (const row of find(id).children) {
        const box = row.getBoundingClientRect(), swatch = row.querySelector("i");
        g.font = getComputedStyle(row).font;
        g.fillStyle = "#111";
        g.textBaseline = "middle";
        g.textAlign = "left";
        const start = swatch ? 24 : 0, rows = wrapped(g, row.textContent, box.width + 1, start);
        rows.forEach((text, k) =>
          g.fillText(text, box.left + (k ? 0 : start), box.top + box.height * (k + 0.5) / rows.length));
        if (swatch) {
          const part = swatch.getBoundingClientRect();
          g.fillStyle = swatch.style.background;
          g.fillRect(part.left, part.top, part.width, part.height);
        }
      }
    });
  }

  let recorder = null;
  function record() {
    if (recorder) { recorder.stop(); return; }
    const target = document.createElement("canvas");
    target.width = room.wide;
    target.height = room.tall;
    const chunks = [];
    recorder = new MediaRecorder(target.captureStream(30));
    recorder.ondataavailable = event => chunks.push(event.data);
    recorder.onstop = () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob(chunks, { type: recorder.mimeType }));
      link.download = `replay.${recorder.mimeType.includes("mp4") ? "mp4" : "webm"}`;
      link.click();
      recorder = null;
      find("record").textContent = "video";
    };
    recorder.start();
    find("record").textContent = "stop";
    const begun = performance.now();
    const next = () => {
      if (!recorder) return;
      const now = (performance.now() - begun) / 1000;
      show(now);
      compose(target);
      if (now < duration + 0.5) requestAnimationFrame(next); else recorder.stop();
    };
    next();
  }

  // all frames of a film as pictures in the page, for a program that reads them there: #frames=30
  function writeFrames(rate) {
    const target = document.createElement("canvas"), list = document.createElement("pre");
    target.width = room.wide;
    target.height = room.tall;
    list.id = "frames";
    const pictures = [];
    for (let frame = 0; frame <= Math.round(duration * rate); frame++) {
      show(frame / rate);
      compose(target);
      pictures.push(target.toDataURL(`image/${kind}`, 0.92).split(",")[1]);
    }
    list.textContent = pictures.join("\n");
    document.body.textContent = "";
    document.body.appendChild(list);
  }

  find("play").onclick = () => { if (!playing && film >= duration) show(0); play(!playing); };
  find("previous").onclick = () => step(-1);
  find("next").onclick = () => step(1);
  find("record").onclick = record;
  find("record").hidden = !window.MediaRecorder;
  find("film").oninput = event => { play(false); show(Number(event.target.value)); };
  window.addEventListener("keydown", event => {
    if (["SELECT", "INPUT"].includes(event.target.tagName) && event.key !== "n" && event.key !== "p") return;
    if (event.key === " ") { event.preventDefault(); find("play").onclick(); }
    if (event.key === "n") step(1);
    if (event.key === "p") step(-1);
  });
  window.addEventListener("resize", () => { resize(); show(film); });
  options("speed", [0.01, 0.1, 0.2, 0.5, 1, 2], settings.speed, value => { settings.speed = value; });
  options("slowdown", [1, 5, 20, 100], settings.slowdown, value => { settings.slowdown = value; });
  if (data.within || !data.impacts.length) for (const id of ["previous", "next"]) find(id).hidden = true;
  if (data.within || !slow.length) find("slowdown").parentElement.hidden = true;
  legend();
  cut();
  root.dataset.tracks = moving.length;
  root.dataset.frames = frames;
  show(0);
  window.replay = { show, toImpact, play, get duration() { return duration; }, filmOf };

  if (place === "t") show(filmOf(Number(value)));
  else if (place === "film") show(Number(value));
  else if (place === "impact" && data.impacts[value - 1]) toImpact(value - 1);
  else if (place !== "frames") play(true);
  requestAnimationFrame(tick);
  const started = () => {
    resize();
    viewer.render();
    if (place === "frames") writeFrames(Number(value));
    root.dataset.ready = "yes";
  };
  setTimeout(started, place === "frames" ? 500 : 0);
})();
