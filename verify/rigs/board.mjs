// board.mjs BOARD.json FILE.ts: writes a program whose types are those of Grafana's schema (npm: @grafana/schema) and whose values are
// those of a board. The compiler of TypeScript judges it: a member that the schema lacks, or a value of another type, is an error.
import { readFileSync, writeFileSync } from "node:fs";

const [boardPath, programPath] = process.argv.slice(2);
const { panels, ...board } = JSON.parse(readFileSync(boardPath, "utf8"));
const kinds = { timeseries: "TimeSeries", stat: "Stat", "state-timeline": "StateTimeline" };
const folders = { timeseries: "timeseries", stat: "stat", "state-timeline": "statetimeline" };

const lines = ['import type { Dashboard, Panel } from "@grafana/schema";'];
for (const [kind, name] of Object.entries(kinds)) {
    const file = `@grafana/schema/dist/esm/raw/composable/${folders[kind]}/panelcfg/x/${name}PanelCfg_types.gen`;
    lines.push(`import type * as ${name} from "${file}";`);
}
// JSON has the values of the enumerations.
lines.push(`type Values<T> = unknown extends T ? T : T extends string ? \`\${T}\` : T extends number | boolean | null | undefined ? T
    : T extends (infer Item)[] ? Values<Item>[] : { [Key in keyof T]: Values<T[Key]> };
type Query = { refId: string; expr: string; legendFormat: string; range: true };
type Shown<Options, Config> = Omit<Values<Panel<Options, Config>>, "options" | "targets">
    & { options: Values<Options>; targets: Query[] };
export const board: Values<Omit<Dashboard, "panels">> = ${JSON.stringify(board, null, 1)};`);
for (const panel of panels) {
    const name = kinds[panel.type];
    if (!name) throw new Error(`${panel.title}: add the schema of ${panel.type} to board.mjs`);
    const config = name === "Stat" ? "Record<string, never>" : `${name}.FieldConfig`;
    lines.push(`export const panel${panel.id}: Shown<${name}.Options, ${config}> = ${JSON.stringify(panel, null, 1)};`);
}
writeFileSync(programPath, lines.join("\n") + "\n");
