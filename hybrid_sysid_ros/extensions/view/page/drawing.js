// The rig: bodies of boxes and discs, moved by their joints. x is to the right, y up, angles are counter-clockwise.

const SVG = "http://www.w3.org/2000/svg";

function made(kind, parent, attributes) {
  const element = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return parent.appendChild(element);
}

export class Drawing {
  constructor(svg, bodies, [left, low, right, high]) {
    svg.replaceChildren();
    const margin = 0.06 * Math.max(right - left, high - low, 0.1);
    svg.setAttribute("viewBox", [left - margin, -high - margin, right - left + 2 * margin, high - low + 2 * margin].join(" "));
    const root = made("g", svg, { transform: "scale(1 -1)" });
    this.moving = [];
    const groups = { "": root };
    for (const body of bodies) {
      const group = (groups[body.name] = made("g", groups[body.on], { "data-body": body.name }));
      const tone = body.joint ? (this.moving.length % 2 ? "moving other" : "moving") : "standing";
      for (const shape of body.shapes) this.draw(group, shape, tone);
      group.setAttribute("transform", `translate(${body.at[0]} ${body.at[1]})`);
      if (body.joint) this.moving.push({ body, group });
    }
  }

  draw(group, { box, disc, at: [x, y] }, tone) {
    if (disc) {
      made("circle", group, { class: tone, cx: x, cy: y, r: disc });
      if (tone !== "standing") made("rect", group, { class: "mark", x: x + 0.25 * disc, y: y - 0.07 * disc, width: 0.65 * disc, height: 0.14 * disc });
    } else {
      const [width, height] = box;
      const rx = 0.2 * Math.min(width, height);
      made("rect", group, { class: tone, x: x - width / 2, y: y - height / 2, width, height, rx });
    }
  }

  // positions: of the joints by name, rad or m
  move(positions) {
    for (const { body, group } of this.moving) {
      const value = positions[body.joint];
      if (!Number.isFinite(value)) continue;
      const [x, y] = body.at;
      const transform = body.slides ? `translate(${x + value} ${y})` : `translate(${x} ${y}) rotate(${(value * 180) / Math.PI})`;
      group.setAttribute("transform", transform);
    }
  }
}
