/** The viewer's own engine on a placement: geometry, visibility, and every kind of impostor that farfield places. */
import type { Vec3 } from "../placementdb/manifest";
import { Streamer } from "../stream/streamer";
import { BACKGROUND } from "./frame";
import type { Given, Way } from "./way";

export async function engineWay({ engine, placement, whole }: Given): Promise<Way> {
  await whole();
  const { manifest } = placement;
  const streamer = new Streamer(placement, engine.pages, () => undefined);
  engine.modes.background = [...BACKGROUND];
  const located = (position: Vec3, direction: Vec3): boolean => {
    engine.locate(position, direction);
    const s = engine.situation;
    if (streamer.denied) throw streamer.denied;
    if (streamer.damaged.size) throw new Error([...streamer.damaged.values()].join("; "));
    if (s.cell < 0) throw new Error(`The walk leaves the view space at ${position.join(", ")}.`);
    const chunkHere = s.chunk < 0 || placement.residentChunk(s.chunk) !== undefined;
    return chunkHere && s.needed.every((page) => streamer.settled(page));
  };
  return {
    claimed: engine.drawn,
    preparedBytes: manifest.file_bytes ?? 0,
    said: `${manifest.counts.impostors} impostors, ${manifest.counts.layers} layers`,
    settle: async (position, direction) => {
      let fetched = false;
      for (;;) {
        const done = located(position, direction);
        if (done) return fetched;
        fetched = true;
        streamer.update(engine.situation.chunk, engine.likelyPages(direction, position), position);
        streamer.upload(Infinity);
        await new Promise((resolve) => setTimeout(resolve, 2));
      }
    },
    draw: (position, direction) => {
      engine.locate(position, direction);
      engine.draw(position, direction);
    },
  };
}
