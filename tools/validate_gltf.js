// Khronos's own glTF validator over files; ends with 1 where one has an error or a warning.
//
//   npm install --prefix build/node --no-save gltf-validator@2.0.0-dev.3.10
//   node tools/validate_gltf.js FILE.glb ...
//
// The package is looked for there, and where you are. tests/core/export/test_gltf_validator.py runs this.
// It does not know MPEG_haptic_material, and says so; tests/core/export/glb_rules.py has the rules of that extension.
const fs = require("fs");
const path = require("path");
const places = [process.cwd(), path.join(__dirname, "..", "build", "node")];
const validator = require(require.resolve("gltf-validator", { paths: places }));

async function main(files) {
  let bad = files.length ? 0 : 1;
  for (const file of files) {
    const { issues } = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    console.log(`${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings`);
    for (const each of issues.messages) console.log(`  ${each.code} ${each.pointer || ""}: ${each.message}`);
    bad += issues.numErrors + issues.numWarnings;
  }
  process.exitCode = bad ? 1 : 0;
}

main(process.argv.slice(2));
